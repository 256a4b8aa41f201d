import { Actions } from './actions.js';
import { Detail } from './detail.js';
import { RobotList } from './list.js';
import { SwarmMap } from './map.js';
import { Model } from './model.js';
import { Link } from './socket.js';
import { Timeline } from './timeline.js';

const element = (id) => document.getElementById(id);
const model = new Model();
const map = new SwarmMap(element('map'), model);
const list = new RobotList(model);
new Detail(model);
const banner = element('banner');

const actions = new Actions(model, (message) => link.send(message));
const link = new Link(model, {
  connected() { banner.hidden = true; actions.connected(); choose(); },
  lost(why) {
    const old = model.robots.size ? ' What is shown is old.' : '';
    banner.textContent = why ? why + old : 'No link to the server: what is shown is old. Connecting again ...';
    banner.hidden = false;
    actions.lost(Boolean(why));
  },
  message(message, now) {
    if (message.kind === 'hello') model.hello(message);
    else if (message.kind === 'rows') model.rows(message, now);
    else if (message.kind === 'links') { model.links = message.links; map.wake(); }
    else if (message.kind === 'detail') {
      const robot = model.robots.get(message.name);
      if (robot) robot.detail = message;
      model.tell('detail');
    } else if (message.kind === 'boxes') model.boxes = message.boxes;
    else if (message.kind === 'playback') { model.playback = message; model.tell('playback'); }
    else if (message.kind === 'answer') actions.answer(message);
    else if (message.kind === 'estop') actions.estopped(message);
    else if (message.kind === 'notice') {
      banner.textContent = message.text;
      banner.hidden = !message.text;
    }
  },
});
const choose = () => link.send({ kind: 'select', names: [...model.selected].slice(-20) });
const timeline = new Timeline(model, (message) => link.send(message));

const isByOdometry = () => ['live', 'recording'].includes(model.source);

// A text that did not change is not read out again.
function show(id, text) { if (element(id).textContent !== text) element(id).textContent = text; }

function counts() {
  const states = new Map();
  let silent = 0;
  const now = performance.now();
  for (const robot of model.robots.values()) {
    if (!model.isHeard(robot, now)) silent += 1;
    else states.set(robot.row.state, (states.get(robot.row.state) || 0) + 1);
  }
  const parts = [...states].map(([state, count]) => `${count} ${state}`);
  if (silent) parts.push(`${silent} not heard`);
  show('counts', `${model.robots.size} robots: ${parts.join(', ') || '-'}`);
  show('clock', model.source === 'live' ? '' : `${model.time.toFixed(1)} s`);
  if (!map.mode) hint(isByOdometry() && model.overlaps() ? OVERLAP : '');
  legend();
}

function legend() {
  const entries = map.legend(), text = JSON.stringify(entries);
  if (text === legend.text) return;
  legend.text = text;
  element('legend').replaceChildren(...entries.map(([colour, name]) => {
    const item = document.createElement('span'), mark = document.createElement('i');
    mark.style.background = colour;
    item.append(mark, name);
    return item;
  }));
}

// What robots report may be chosen as their colour, and a label selects its robots.
function choices() {
  const keys = new Set(['state', 'pattern', 'protection', 'platform']), labels = new Set();
  for (const { row } of model.robots.values()) {
    for (const kind of ['report', 'readings']) for (const key of Object.keys(row[kind] || {})) keys.add(`${kind}:${key}`);
    for (const label of row.labels || []) labels.add(label);
  }
  if (labels.size) keys.add('labels');
  element('links-label').hidden = !model.links.length;
  fill(element('colour'), [...keys].map((key) => { // a pattern may report a `state` of its own
    const name = key.replace(/^\w+:/, '');
    return [key, key !== name && keys.has(name) ? `reported ${name}` : name];
  }));
  element('label-choice').hidden = !labels.size;
  fill(element('label'), [['', 'select ...'], ...[...labels].sort().map((one) => [one, one])]);
}

function fill(select, entries) {
  if ([...select.options].map((one) => one.value).join() === entries.map(([key]) => key).join()) return;
  const chosen = select.value;
  select.replaceChildren(...entries.map(([key, text]) => new Option(text, key)));
  if (entries.some(([key]) => key === chosen)) select.value = chosen;
}

model.addEventListener('hello', () => {
  element('title').textContent = `${model.swarm || 'swarmd'}${model.role === 'viewer' ? ' (read only)' : ''}`;
  document.title = element('title').textContent;
  document.body.classList.toggle('operator', model.role === 'operator' && !model.playback);
  element('align').hidden = !isByOdometry();
  const fields = Object.keys((model.arena || {}).fields || {});
  element('fields').hidden = !fields.length;
  fill(element('field'), [['', 'none'], ...fields.map((one) => [one, one])]);
  map.showField(fields[0] || '');
  element('field').value = map.field;
});
model.addEventListener('selection', choose);
setInterval(() => { counts(); choices(); }, 500);

element('fit').addEventListener('click', () => map.fit());
const press = (id, set) => element(id).addEventListener('click', () => {
  const isOn = element(id).getAttribute('aria-pressed') !== 'true';
  element(id).setAttribute('aria-pressed', isOn);
  set(isOn);
  map.wake();
});
press('follow', (isOn) => { map.isFollowing = isOn; });
const HINTS = {
  measure: 'Drag from one place to another.',
  align: 'Odometry knows no common origin. Drag a robot to its place; drag beside the selected robots to turn them.',
};
const OVERLAP = 'Robots are drawn at one place: the odometry of each begins at 0 where it was switched on. Align places them. For simulated robots, sim up --web shows true positions.';
function hint(text) {
  show('hint', text);
  element('hint').hidden = !text;
}
function mode(name, isOn) { // one at a time
  for (const other of Object.keys(HINTS)) element(other).setAttribute('aria-pressed', isOn && other === name);
  map.mode = isOn ? name : '';
  map.ruler = null;
  hint(HINTS[map.mode] || '');
  element('forget').hidden = map.mode !== 'align';
}
for (const name of Object.keys(HINTS)) press(name, (isOn) => mode(name, isOn));
element('forget').addEventListener('click', () => { model.keepOffsets(true); map.hasFitted = false; });
element('label').addEventListener('change', (event) => {
  const label = event.target.value;
  model.select([...model.robots.values()].filter(({ row }) => (row.labels || []).includes(label)).map((one) => one.name));
  event.target.value = '';
});
for (const name of ['trails', 'links', 'names']) {
  element(name).addEventListener('change', (event) => { map.shows[name] = event.target.checked; map.wake(); });
}
element('field').addEventListener('change', (event) => map.showField(event.target.value));
element('colour').addEventListener('change', (event) => { map.colourBy(event.target.value); legend(); });
element('all').addEventListener('click', () => model.select(list.chosen().map((robot) => robot.name)));
element('none').addEventListener('click', () => model.select([]));

const kept = (key, value) => { try { if (value !== undefined) localStorage.setItem(key, value); return localStorage.getItem(key); } catch { return null; } };
for (const [name, usual] of [['dark', matchMedia('(prefers-color-scheme: dark)').matches], ['large', false]]) {
  const box = element(name);
  box.checked = (kept(name) ?? String(usual)) === 'true';
  const paint = () => { document.documentElement.classList.toggle(name, box.checked); map.resize(); map.wake(); };
  box.addEventListener('change', () => { kept(name, box.checked); paint(); });
  paint();
}

document.addEventListener('keydown', (event) => {
  if (event.key === 'Escape' && event.shiftKey && document.body.matches('.operator')) { actions.estop(); return; }
  if (event.target.matches('input, select, textarea') || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === ' ' && event.target.matches('button, summary')) return; // presses what has the focus
  const keys = { f: 'fit', o: 'follow', m: 'measure', a: 'align', ' ': 'play' };
  if (keys[event.key] && !element(keys[event.key]).closest('[hidden]')) {
    event.preventDefault();
    element(keys[event.key]).click();
  } else if (event.key === 'Escape') model.select([]);
  else if (event.key === '/') { event.preventDefault(); element('filter').focus(); }
});

window.swarm = { model, map, list, actions, timeline }; // for tests
