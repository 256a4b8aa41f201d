// Plays the run that is embedded in the report, on the map of the page of a swarm.

import { Colouring } from './colours.js';
import { Legend } from './legend.js';
import { SwarmMap } from './map.js';
import { Model } from './model.js';
import { Timeline } from './timeline.js';

const LARGEST = 32767; // a coordinate; a yaw of pi
const ABSENT = -32768; // in place of a coordinate of a body that is not there
const element = (id) => document.getElementById(id);
const data = JSON.parse(element('run-data').textContent);
const bytes = Uint8Array.from(atob(data.poses), (letter) => letter.charCodeAt(0));
const poses = new Int16Array(bytes.buffer);
const robots = data.hello.robots.length, bodies = robots + data.boxes.length;

const model = new Model();
const map = new SwarmMap(element('map'), model);
const legend = new Legend(element('legend'), () => map.legend());
let at = data.start, applied = -1, last = null;

// x and y in m and yaw in rad of a body at a time, between two samples; null where it is not there.
function pose(body, time) {
  const place = Math.min(time / data.period, data.count - 1);
  const first = Math.floor(place), share = place - first, next = Math.min(first + 1, data.count - 1);
  const a = 3 * (first * bodies + body), b = 3 * (next * bodies + body);
  if (poses[a] === ABSENT || poses[b] === ABSENT) return null;
  const between = (k) => poses[a + k] + share * (poses[b + k] - poses[a + k]);
  let turn = poses[b + 2] - poses[a + 2];
  turn -= 2 * LARGEST * Math.round(turn / (2 * LARGEST)); // the shorter way round
  return [data.centre[0] + data.unit * between(0), data.centre[1] + data.unit * between(1),
    (poses[a + 2] + share * turn) * Math.PI / LARGEST];
}

function show(time) {
  const now = performance.now(), index = Math.min(Math.floor(time / data.row_period + 1e-6), data.rows.length - 1);
  if (index < applied) applied = -1;
  while (applied < index) {
    applied += 1;
    model.rows({ rows: data.rows[applied], links: data.links[applied] }, now);
  }
  const found = [];
  for (let i = 0; i < robots; i++) { const one = pose(i, time); if (one) found.push([i, ...one]); }
  const view = new DataView(new ArrayBuffer(20 + 16 * found.length));
  view.setFloat64(8, time, true);
  view.setUint32(16, found.length, true);
  found.forEach(([i, x, y, yaw], k) => {
    view.setUint32(20 + 16 * k, i, true);
    [x, y, yaw].forEach((value, j) => view.setFloat32(24 + 16 * k + 4 * j, value, true));
  });
  const there = new Set(found.map(([i]) => i));
  for (const robot of model.byIndex) if (!there.has(robot.index)) robot.x = NaN;
  model.boxes = data.boxes.map((shape, k) => ({ shape, pose: pose(robots + k, time) })).filter((box) => box.pose);
  model.frame(view, now);
}

function step(now) {
  const { playback } = model;
  if (!playback.is_playing) { last = null; return; }
  if (last !== null) at = Math.min(at + (now - last) / 1000 * playback.speed, playback.duration);
  last = now;
  show(at);
  if (at >= playback.duration) playback.is_playing = false;
  model.tell('playback');
  if (playback.is_playing) requestAnimationFrame(step);
  else last = null;
}

// What a server does for the page of a swarm.
function send(message) {
  const { playback } = model;
  if (message.kind === 'seek') {
    at = message.time;
    show(at);
  } else if (message.kind === 'play') {
    const begins = message.is_playing && !playback.is_playing;
    Object.assign(playback, { is_playing: message.is_playing, speed: message.speed });
    if (begins && at >= playback.duration) { at = 0; model.forgetTrails(); }
    if (begins) requestAnimationFrame(step);
  }
}

// Without walls, Fit shows every place of the run.
if (!data.hello.arena) {
  map.fit = () => {
    const side = 2 * LARGEST * data.unit + 1.2;
    map.centre = [...data.centre];
    map.scale = Math.min(map.canvas.clientWidth, map.canvas.clientHeight) / side;
    map.hasFitted = true;
    map.wake();
  };
}

const timeline = new Timeline(model, send);
model.isConnected = true;
model.hello(data.hello);
element('speed').value = '5';
Object.assign(model.playback, { is_playing: false, speed: 5 });
show(at);
timeline.state();
const keys = new Set(['state', 'pattern', 'protection', 'platform']);
for (const rows of data.rows) {
  for (const row of Object.values(rows)) for (const key of Object.keys(row.report || {})) keys.add(`report:${key}`);
}
element('colour').append(...[...keys].map((key) => new Option(key, key)));
const recolour = () => { map.colouring = new Colouring(element('colour').value); map.wake(); legend.draw(); };
element('colour').value = keys.has('report:opinion') ? 'report:opinion' : 'state';
element('colour').addEventListener('change', recolour);
element('trails').addEventListener('change', (event) => { map.shows.trails = event.target.checked; map.wake(); });
element('names').addEventListener('change', (event) => { map.shows.names = event.target.checked; map.wake(); });
element('fit').addEventListener('click', () => map.fit());
// The wheel scrolls the report, unless the map has been clicked.
element('player').addEventListener('wheel', (event) => {
  if (document.activeElement !== element('map')) event.stopPropagation();
}, { capture: true, passive: true });
map.shows.names = element('names').checked = innerWidth >= 600; // on a phone they would overlap
recolour();
setInterval(() => legend.draw(), 500);
window.swarm = { model, map, timeline }; // for tests
