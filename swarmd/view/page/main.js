import { Actions } from './actions.js';
import { Colouring } from './colours.js';
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

const link = new Link(model, {
  connected() { banner.hidden = true; },
  lost(why) {
    banner.textContent = why || 'No link to the server: what is shown is old. Connecting again ...';
    banner.hidden = false;
  },
  message(message, now) {
    if (message.kind === 'hello') model.hello(message);
    else if (message.kind === 'rows') model.rows(message, now);
    else if (message.kind === 'detail') {
      const robot = model.robots.get(message.name);
      if (robot) robot.detail = message;
      model.tell('detail');
    } else if (message.kind === 'boxes') model.boxes = message.boxes;
    else if (message.kind === 'playback') { model.playback = message; model.tell('playback'); }
    else if (message.kind === 'answer') actions.answer(message);
    else if (message.kind === 'notice') {
      banner.textContent = message.text;
      banner.hidden = !message.text;
    }
  },
});
const actions = new Actions(model, (message) => link.send(message));
const timeline = new Timeline(model, (message) => link.send(message));

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
  element('counts').textContent = `${model.robots.size} robots: ${parts.join(', ') || '-'}`;
  element('clock').textContent = model.source === 'live' ? '' : `${model.time.toFixed(1)} s`;
  legend();
}

function legend() {
  element('legend').replaceChildren(...map.legend().map(([colour, text]) => {
    const item = document.createElement('span');
    const mark = document.createElement('i');
    mark.style.background = colour;
    item.append(mark, text);
    return item;
  }));
}

function colours() {
  const keys = new Set(['state', 'pattern', 'protection', 'platform']);
  for (const { row } of model.robots.values()) {
    for (const kind of ['report', 'readings']) for (const key of Object.keys(row[kind] || {})) keys.add(`${kind}:${key}`);
  }
  const select = element('colour');
  if ([...select.options].map((one) => one.value).join() === [...keys].join()) return;
  const chosen = select.value || 'state';
  select.replaceChildren(...[...keys].map((key) => new Option(key, key)));
  select.value = keys.has(chosen) ? chosen : 'state';
}

model.addEventListener('hello', () => {
  element('title').textContent = `${model.swarm || 'swarmd'}${model.role === 'viewer' ? ' (read only)' : ''}`;
  document.title = element('title').textContent;
  document.body.classList.toggle('viewer', model.role === 'viewer');
  document.body.classList.toggle('recorded', model.source === 'run');
  element('align').hidden = model.source !== 'live';
  const fields = Object.keys((model.arena || {}).fields || {});
  element('fields').hidden = !fields.length;
  element('field').replaceChildren(new Option('none', ''), ...fields.map((name) => new Option(name)));
  map.showField(fields[0] || '');
  element('field').value = map.field;
});
model.addEventListener('selection', () => link.send({ kind: 'select', names: [...model.selected] }));
setInterval(() => { counts(); colours(); }, 500);

element('fit').addEventListener('click', () => map.fit());
const press = (id, set) => element(id).addEventListener('click', () => {
  const isOn = element(id).getAttribute('aria-pressed') !== 'true';
  element(id).setAttribute('aria-pressed', isOn);
  set(isOn);
  map.wake();
});
press('follow', (isOn) => { map.isFollowing = isOn; });
press('measure', (isOn) => { map.mode = isOn ? 'measure' : ''; if (!isOn) map.ruler = null; });
press('align', (isOn) => { map.mode = isOn ? 'align' : ''; });
for (const name of ['trails', 'links', 'names']) {
  element(name).addEventListener('change', (event) => { map.shows[name] = event.target.checked; map.wake(); });
}
element('field').addEventListener('change', (event) => map.showField(event.target.value));
element('colour').addEventListener('change', (event) => { map.colouring = new Colouring(event.target.value); map.wake(); legend(); });
element('all').addEventListener('click', () => model.select(list.chosen().map((robot) => robot.name)));
element('none').addEventListener('click', () => model.select([]));

const dark = element('dark');
dark.checked = (localStorage.getItem('dark') ?? String(matchMedia('(prefers-color-scheme: dark)').matches)) === 'true';
const paint = () => { document.documentElement.classList.toggle('dark', dark.checked); map.wake(); };
dark.addEventListener('change', () => { localStorage.setItem('dark', dark.checked); paint(); });
paint();

document.addEventListener('keydown', (event) => {
  if (event.target.matches('input, select, textarea') || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = { f: 'fit', o: 'follow', m: 'measure', a: 'align', ' ': 'play' };
  if (keys[event.key] && !element(keys[event.key]).hidden) {
    event.preventDefault();
    element(keys[event.key]).click();
  } else if (event.key === 'Escape') model.select([]);
  else if (event.key === '/') { event.preventDefault(); element('filter').focus(); }
});

window.swarm = { model, map, list, actions, timeline }; // for tests
