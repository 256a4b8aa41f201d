// The list of robots: sorted, filtered, with only the visible rows in the document.

import { colourOf, isAlarm, reasonOf, signOf, wordOf } from './states.js';

const ROW = 30; // px, until a row is drawn
const PERIOD = 250; // ms between two updates
const LOW = 0.2; // the share of a battery that is shown as low
const NOW = 2; // s within which a robot was heard now
const CALM = 10000; // ms for which all robots are heard before their column leaves its room

const { compare } = new Intl.Collator(undefined, { numeric: true });
const heard = (age) => (age < NOW ? 'now' : Number.isFinite(age) ? `${age.toFixed(0)} s ago` : 'never');

export const COLUMNS = [
  ['name', 'Name', (robot) => robot.name],
  ['state', 'State', (robot, now, model) => model.stateOf(robot, now) || '?'],
  ['pattern', 'Pattern', (robot) => (robot.row.pattern || '').replaceAll('_', ' ')],
  ['why', 'Why', (robot, now, model) => reasonOf(robot.row, model.time)],
  ['protection', 'Protection', (robot) => robot.row.protection || ''],
  ['battery', 'Battery', (robot) => (robot.row.battery == null ? '-' : `${(100 * robot.row.battery).toFixed(0)} %${robot.row.battery <= LOW ? ' low' : ''}`)],
  ['age', 'Heard', (robot, now, model) => heard(model.age(robot, now))],
];
const NUMBERS = {
  battery: (robot) => robot.row.battery ?? Infinity, age: (robot, now, model) => model.age(robot, now),
};

export class RobotList {
  constructor(model) {
    this.model = model;
    this.sort = ''; // alarms first, then by name
    this.direction = 1;
    this.words = [];
    this.lateAt = -Infinity; // when a robot was last silent, in ms
    this.pool = []; // rows that are used again
    [this.before, this.after] = [spacer(), spacer()];
    this.pane = document.getElementById('rows');
    this.body = document.getElementById('body');
    this.heads();
    this.pane.addEventListener('scroll', () => this.wake());
    this.pane.addEventListener('keydown', (event) => this.key(event));
    this.body.addEventListener('click', (event) => this.click(event));
    document.getElementById('filter').addEventListener('input', (event) => {
      this.words = event.target.value.toLowerCase().split(/\s+/).filter(Boolean);
      this.wake();
    });
    for (const news of ['hello', 'rows', 'selection', 'frame']) model.addEventListener(news, () => this.wake());
    setInterval(() => this.wake(), 1000);
    new ResizeObserver(() => this.wake()).observe(this.pane);
  }

  heads() {
    const row = document.getElementById('heads');
    for (const [key, title] of COLUMNS) {
      const head = document.createElement('th');
      head.textContent = title;
      head.scope = 'col';
      head.tabIndex = 0;
      head.dataset.key = key;
      head.className = key;
      const sort = () => {
        this.direction = this.sort === key ? -this.direction : 1;
        this.sort = key;
        for (const one of row.children) one.removeAttribute('aria-sort');
        head.setAttribute('aria-sort', this.direction > 0 ? 'ascending' : 'descending');
        this.wake();
      };
      head.addEventListener('click', sort);
      head.addEventListener('keydown', (event) => { if (event.key === 'Enter') sort(); });
      row.append(head);
    }
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    setTimeout(() => { this.isWaiting = false; this.draw(); }, PERIOD);
  }

  chosen() {
    const now = performance.now();
    const matches = (robot) => {
      const { row } = robot;
      const text = [robot.name, row.state, wordOf(row), reasonOf(row, this.model.time), row.lost ? 'base lost' : '', row.pattern, row.protection, row.presence, this.model.stateOf(robot, now), ...(row.labels || [])].join(' ').toLowerCase();
      return this.words.every((word) => text.includes(word));
    };
    const robots = [...this.model.robots.values()].filter(matches);
    const column = COLUMNS.find(([key]) => key === (this.sort || 'name'));
    const of = NUMBERS[this.sort] || column[2];
    const keys = new Map(robots.map((robot) => [robot, of(robot, now, this.model)]));
    const calm = new Map(robots.map((robot) => [robot, Number(this.sort !== '' || !isAlarm(this.model.stateOf(robot, now)))]));
    robots.sort((one, other) => {
      if (calm.get(one) !== calm.get(other)) return calm.get(one) - calm.get(other);
      const a = keys.get(one), b = keys.get(other);
      const order = typeof a === 'number' ? a - b : compare(a, b);
      return this.direction * (order || 0);
    });
    return robots;
  }

  // Update only visible rows, and in them only cells that changed.
  draw() {
    const robots = this.chosen(), now = performance.now();
    this.shown = robots;
    const row = this.pool.length && this.pool[0].isConnected ? this.pool[0].getBoundingClientRect().height : ROW;
    this.height = row || ROW;
    const first = Math.max(0, Math.floor(this.pane.scrollTop / this.height) - 3);
    const last = Math.min(robots.length, first + Math.ceil(this.pane.clientHeight / this.height) + 6);
    while (this.pool.length < last - first) this.pool.push(emptyRow());
    robots.slice(first, last).forEach((robot, i) => this.fill(this.pool[i], robot, now, first + i));
    this.before.firstChild.style.height = `${first * this.height}px`;
    this.after.firstChild.style.height = `${(robots.length - last) * this.height}px`;
    const rows = [this.before, ...this.pool.slice(0, last - first), this.after];
    if (rows.length !== this.body.children.length) this.body.replaceChildren(...rows);
    this.body.parentElement.setAttribute('aria-rowcount', robots.length + 1);
    const all = [...this.model.robots.values()]; // a column without values leaves its room to the others
    this.body.parentElement.classList.toggle('no-battery', all.every((robot) => robot.row.battery === undefined));
    if (this.sort === 'age' || all.some((robot) => this.model.age(robot, now) >= NOW)) this.lateAt = now;
    this.body.parentElement.classList.toggle('no-age', now - this.lateAt > CALM);
    this.body.parentElement.classList.toggle('no-pattern', all.every((robot) => !robot.row.pattern));
  }

  fill(row, robot, now, index) {
    const isHeard = this.model.isHeard(robot, now);
    set(row.dataset, 'name', robot.name);
    set(row, 'className', isHeard ? '' : 'stale');
    for (const [key, value] of [['aria-selected', this.model.selected.has(robot.name)], ['aria-rowindex', index + 2]]) {
      if (row.getAttribute(key) !== String(value)) row.setAttribute(key, value);
    }
    COLUMNS.forEach(([key, , text], i) => {
      const cell = row.children[i], value = text(robot, now, this.model);
      if (key === 'state' && robot.row.lost) set(cell, 'className', 'state lost');
      else if (key === 'state') set(cell, 'className', 'state');
      if (key !== 'state') {
        if (cell.firstChild.data !== value) { cell.firstChild.data = value; cell.title = value; }
        return;
      }
      if (cell.dataset.shown === value) return;
      cell.dataset.shown = cell.title = value;
      cell.firstChild.style.background = colourOf(value);
      cell.firstChild.className = value === 'at rest' ? 'shade' : '';
      cell.lastChild.data = `${signOf(value)} ${value}`;
    });
  }

  click(event) {
    const row = event.target.closest('tr[data-name]');
    if (!row) return;
    const { name } = row.dataset;
    if (event.shiftKey && this.anchor) {
      const names = this.shown.map((robot) => robot.name);
      const [a, b] = [names.indexOf(this.anchor), names.indexOf(name)].sort((one, other) => one - other);
      if (a >= 0) { this.model.select(names.slice(a, b + 1)); return; }
    }
    this.anchor = name;
    this.model.select([name], event.ctrlKey || event.metaKey);
  }

  key(event) {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (!this.shown || !this.shown.length) return;
    const names = this.shown.map((robot) => robot.name);
    if (event.key === 'a' && (event.ctrlKey || event.metaKey)) {
      event.preventDefault();
      this.model.select(names);
    }
    if (!step) return;
    event.preventDefault();
    const at = names.indexOf(this.anchor) + step;
    const next = Math.min(Math.max(at, 0), names.length - 1);
    this.anchor = names[next];
    this.model.select([this.anchor], event.shiftKey);
    const { height } = this, top = next * height, { scrollTop, clientHeight } = this.pane;
    if (top < scrollTop) this.pane.scrollTop = top;
    if (top > scrollTop + clientHeight - 3 * height) this.pane.scrollTop = top - clientHeight + 3 * height;
  }
}

function set(object, key, value) { if (object[key] !== value) object[key] = value; }

function emptyRow() {
  const row = document.createElement('tr');
  for (const [key] of COLUMNS) {
    const cell = row.insertCell();
    cell.className = key;
    if (key === 'state') cell.append(document.createElement('i'));
    cell.append('');
  }
  return row;
}

function spacer() {
  const row = document.createElement('tr');
  row.className = 'space';
  row.setAttribute('aria-hidden', 'true');
  row.insertCell().colSpan = COLUMNS.length;
  return row;
}
