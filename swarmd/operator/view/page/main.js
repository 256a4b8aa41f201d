import { Actions } from './actions.js';
import { Detail } from './detail.js';
import { Legend } from './legend.js';
import { RobotList } from './list.js';
import { ABOVE_SCALE, SwarmMap } from './map.js';
import { Model } from './model.js';
import { Panels, isOnPhone } from './panels.js';
import { Plots } from './plots.js';
import { Link } from './socket.js';
import { wordOf } from './states.js';
import { Stick } from './stick.js';
import { Timeline } from './timeline.js';

const MAX_PATTERNS = 2; // that are named in the head
const element = (id) => document.getElementById(id);
const model = new Model();
const map = new SwarmMap(element('map'), model);
const list = new RobotList(model);
const detail = new Detail(model, (incident) => actions.act('fetch', { incident }));
const pick = (robots) => model.select(robots.map((one) => one.name));
const legend = new Legend(element('legend'), () => map.legend(), pick), chips = new Legend(element('chips'), () => map.states(), pick);
const panels = new Panels(map);
const banner = element('banner');
const free = () => { // what the map shows by Fit is not covered
  const size = (id, key) => (element(id)[key] ? element(id)[key] + 12 : 0), isPhone = isOnPhone();
  const isColumn = !isPhone && !document.body.matches('.present'); // beside the map, which is wider than an arena
  const [tools, hints, legend] = ['tools', 'hints', 'legend'].map((id) => size(id, 'offsetHeight'));
  const side = (...ids) => (isPhone ? 0 : Math.max(...ids.map((id) => size(id, 'offsetWidth'))));
  const isShort = isPhone && matchMedia('(max-height: 700px) and (orientation: landscape)').matches; // its tools are a column at the right
  const column = isColumn ? side('tools', 'hints', 'legend') : 0, commands = side('commands');
  // The card of a robot counts on a phone alone: in a wide window a click that selects a robot must not move the map.
  const strip = isPhone && element('answer-list').children.length ? element('answers').offsetHeight : 0; // over the map
  const sheet = strip + (isPhone ? Math.max(...['detail-pane', 'look', 'list-pane'].map((id) => element(id).offsetHeight)) : 0);
  const insets = isColumn ? [0, 0, commands + column, side('look')] : [(isShort ? 8 : tools) + hints, Math.max(legend + strip, sheet) + ABOVE_SCALE, commands, isShort ? size('tools', 'offsetWidth') : side('look')];
  const isSame = `${insets}` === `${map.insets}`;
  map.insets = insets;
  map.corner = [commands, isColumn ? legend : Math.max(legend + strip, sheet)];
  for (const [name, value] of [['--tools', tools], ['--tools-width', size('tools', 'offsetWidth')], ['--above', insets[0]]]) document.documentElement.style.setProperty(name, `${value}px`);
  if (map.hasFitted && !map.isTouched && !isSame) map.fit();
};
for (const id of ['tools', 'hints', 'legend', 'commands', 'look', 'detail-pane', 'list-pane', 'answer-list']) new ResizeObserver(() => requestAnimationFrame(free)).observe(element(id)); // not within: it changes sizes
new ResizeObserver(() => chips.fit()).observe(element('chips'));

const actions = new Actions(model, (message) => link.send(message), () => panels.open('commands', false));
const stick = new Stick(model, (message) => link.send(message));
const link = new Link(model, {
  connected() { banner.hidden = true; actions.connected(); choose(); },
  lost(why) {
    const old = model.robots.size ? ' What is shown is old.' : '';
    banner.textContent = why ? why + old : 'No link to the server: what is shown is old. Connecting again ...';
    banner.hidden = false;
    model.lookAt(null);
    actions.lost(Boolean(why));
    stick.disconnected();
  },
  message(message, now) {
    if (message.kind === 'hello') model.hello(message);
    else if (message.kind === 'rows') { model.rows(message, now); lost(); }
    else if (message.kind === 'links') { model.links = message.links; map.wake(); }
    else if (message.kind === 'programs') {
      show('programs', message.programs.length ? `Zenoh programs: ${message.programs.join(', ')}` : '');
      element('programs').hidden = !message.programs.length;
    } else if (message.kind === 'overload') {
      show('overload', message.text);
      element('overload').hidden = !message.text;
    } else if (message.kind === 'detail') {
      const robot = model.robots.get(message.name);
      if (robot) robot.detail = message;
      model.tell('detail');
    } else if (message.kind === 'boxes') model.boxes = message.boxes;
    else if (message.kind === 'plots') model.plot(message);
    else if (message.kind === 'marks') { model.marks = message.marks; model.tell('plots'); }
    else if (message.kind === 'playback') { model.playback = message; model.tell('playback'); }
    else if (message.kind === 'answer') actions.answer(message);
    else if (message.kind === 'hand') stick.answer(message);
    else if (message.kind === 'estop') {
      if (!message.is_final) model.lookAt(null);
      actions.estopped(message);
    }
    else if (message.kind === 'notice') {
      banner.textContent = message.text;
      banner.hidden = !message.text;
    }
  },
});
const choose = () => link.send({ kind: 'select', names: [...model.selected].slice(-20) });
model.sendPast = (time) => link.send({ kind: 'past', time });
const timeline = new Timeline(model, (message) => link.send(message));
const plots = new Plots(model, (time) => timeline.to(time));

const isByOdometry = () => ['live', 'recording'].includes(model.source);

// Set a text only if it has changed: screen readers would read it again.
function show(id, text) { if (element(id).textContent !== text) element(id).textContent = text; }

function counts() {
  const size = model.robots.size;
  show('counts', `${size} ${size === 1 ? 'robot' : 'robots'}: ${running()}`);
  element('counts').title = `${size} ${size === 1 ? 'robot' : 'robots'}: ${running(Infinity)}`;
  element('legend').dataset.runs = running(); // seen in Map only, which has no first line
  chips.draw();
  show('clock', clock());
  const isUnaligned = isByOdometry() && model.isUnaligned();
  element('caveat').hidden = !isUnaligned || map.mode === 'align';
  element('map').classList.toggle('unaligned', isUnaligned && map.mode !== 'align');
  legend.draw();
}

// The patterns that run, each with its number of robots, the most frequent first.
function running(most = MAX_PATTERNS) {
  const numbers = new Map();
  const [heard] = map.heard();
  for (const { row } of heard) if (row.pattern) numbers.set(row.pattern, (numbers.get(row.pattern) || 0) + 1);
  const some = [...numbers].sort(([, one], [, other]) => other - one).map(([name, number]) => `${name.replaceAll('_', ' ')} ${number}`);
  const rest = some.splice(most).length;
  return some.length ? some.join(', ') + (rest ? `, ${rest} more` : '') : heard.length ? 'none runs' : 'none is heard'; // a silent robot may still run
}

function clock() {
  if (model.source === 'live') return `Clock ${plots.clockOf(plots.shown())}`;
  return `${model.source === 'world' ? 'Simulated time' : 'Time of the run'} ${model.time.toFixed(1)} s`;
}

// A robot whose base is lost takes no command, not even a stop: show that at once, in any state.
function lost() {
  const now = performance.now();
  const robots = [...model.robots.values()].filter((one) => one.row.lost && model.isHeard(one, now));
  const some = robots.slice(0, 5).map((one) => `${one.name} (${wordOf(one.row)}; ${one.row.lost})`);
  const rest = robots.length > 5 ? `, and ${robots.length - 5} more` : '';
  show('lost', robots.length ? `Base lost: ${some.join(', ')}${rest}. It takes no command: look at the robot.` : '');
  element('lost').hidden = !robots.length;
}

// Reports may be chosen as the robots' colour, and a label selects its robots.
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
  const size = (label) => [...model.robots.values()].filter(({ row }) => (row.labels || []).includes(label)).length;
  fill(element('label'), [['', 'select ...'], ...[...labels].sort().map((one) => [one, `${one} (${size(one)})`])]);
}

function fill(select, entries) {
  if ([...select.options].map((one) => one.value + one.text).join() === entries.map(([key, text]) => key + text).join()) return;
  const chosen = select.value;
  select.replaceChildren(...entries.map(([key, text]) => new Option(text, key)));
  if (entries.some(([key]) => key === chosen)) select.value = chosen;
}

let hasPlayed = false;
model.addEventListener('hello', () => {
  element('title').textContent = `${model.swarm || 'swarmd'}${model.role === 'viewer' ? ' (read only)' : ''}`;
  document.title = element('title').textContent;
  element('key').textContent = model.key && `as ${model.key}`;
  document.body.classList.toggle('operator', model.role === 'operator' && !model.playback);
  element('align').hidden = !isByOdometry();
  element('back').hidden = Boolean(model.playback);
  element('seek').hidden = !model.playback;
  const fields = Object.keys((model.arena || {}).fields || {});
  element('fields').hidden = !fields.length;
  fill(element('field'), [['', 'none'], ...fields.map((one) => [one, one])]);
  if (model.playback && !hasPlayed) panels.set('time', true); // its play button, on a phone, too
  hasPlayed = Boolean(model.playback);
  map.showField(fields[0] || '');
  element('field').value = map.field;
});
model.addEventListener('selection', choose);
model.addEventListener('past', () => { if (model.past !== null) panels.open('commands', false); });
// The map shows what the head counts, also while no frame comes.
let countedAt = 0, silent = 0;
function count() {
  counts();
  choices();
  const [, { length }] = map.heard();
  if (length !== silent) map.wake();
  silent = length;
}
// A page that was held up has messages that wait: it reads them before it calls robots silent.
setInterval(() => {
  const now = performance.now();
  setTimeout(count, now - countedAt > 1500 ? 200 : 0);
  countedAt = now;
}, 500);

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
  align: 'Odometry has no common origin. Drag a robot to its place; drag beside the selected robots to turn them.',
};
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
element('colour').addEventListener('change', (event) => { map.colourBy(event.target.value); legend.draw(); });
element('all').addEventListener('click', () => model.select(list.chosen().map((robot) => robot.name)));
element('none').addEventListener('click', () => model.select([]));
element('detail-close').addEventListener('click', () => model.select([]));
element('hints').addEventListener('click', (event) => { const note = event.target.closest('p'); if (note) note.classList.toggle('open'); });
element('detail-more').addEventListener('toggle', (event) => { if (event.target.open && isOnPhone()) element('detail-pane').scrollTop = event.target.offsetTop - 44; });
element('detail-reset').addEventListener('click', () => actions.reset([[...model.selected].at(-1)], element('detail-reset')));
for (const id of ['present', 'present-end']) element(id).addEventListener('click', () => panels.present());

document.addEventListener('keydown', (event) => {
  if (event.key === 'Escape' && event.shiftKey && document.body.matches('.operator')) { actions.estop(); return; }
  if (event.key === 'Escape' && panels.closed()) return;
  if (event.target.matches('input:not([type="checkbox"], [type="range"]), select, textarea') || event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.key === ' ' && event.target.matches('button, summary, input')) return; // presses what has the focus
  const keys = {
    f: 'present', 0: 'fit', o: 'follow', m: 'measure', a: 'align', t: 'robots-open', p: 'time-open', l: 'look-open', r: 'run-open', ' ': 'play',
  };
  const target = keys[event.key];
  if (target && isUsable(target)) {
    event.preventDefault();
    element(target).click();
  } else if (event.key === 'Escape') {
    if (document.body.matches('.present')) panels.present(false);
    else model.select([]);
  } else if (event.key === '/') {
    event.preventDefault();
    panels.open('list-pane', true);
    element('filter').focus();
  }
});

// A key acts as its button; keys of commands only on a page that may command.
function isUsable(id) {
  if (element(id).closest('[hidden]')) return false;
  return id !== 'run-open' || document.body.matches('.operator');
}

window.swarm = { model, map, list, actions, timeline, panels, plots, detail }; // for tests
