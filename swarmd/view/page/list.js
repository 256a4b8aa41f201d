// The list of robots: sorted, filtered, and drawn only where it is seen. It repeats what the map shows.

import { stateColour } from './colours.js';

const ROW = 30; // px
const PERIOD = 250; // ms between two updates
const number = (value, digits, unit) => (Number.isFinite(value) ? `${value.toFixed(digits)}${unit}` : '-');

const { compare } = new Intl.Collator(undefined, { numeric: true });
const heard = (age) => (Number.isFinite(age) ? `${age.toFixed(age < 10 ? 1 : 0)} s ago` : 'never');

export const COLUMNS = [
  ['name', 'Name', (robot) => robot.name],
  ['state', 'State', (robot, now, model) => (model.isHeard(robot, now) ? robot.row.state || '?' : `silent${robot.row.state ? `, was ${robot.row.state}` : ''}`)],
  ['why', 'Why', (robot) => robot.row.why || ''],
  ['pattern', 'Pattern', (robot) => robot.row.pattern || ''],
  ['protection', 'Protection', (robot) => robot.row.protection || ''],
  ['battery', 'Battery', (robot) => (robot.row.battery === undefined ? '-' : number(100 * robot.row.battery, 0, ' %'))],
  ['age', 'Heard', (robot, now, model) => heard(model.age(robot, now))],
  ['near', 'Near', (robot) => number(robot.row.near, 2, ' m')],
  ['x', 'x', (robot) => number(robot.x, 2, ' m')],
  ['y', 'y', (robot) => number(robot.y, 2, ' m')],
];
const NUMBERS = {
  near: (robot) => robot.row.near ?? Infinity, battery: (robot) => robot.row.battery ?? Infinity,
  age: (robot, now, model) => model.age(robot, now), x: (robot) => robot.x, y: (robot) => robot.y,
};

export class RobotList {
  constructor(model) {
    this.model = model;
    this.sort = 'name';
    this.direction = 1;
    this.words = [];
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
      const text = [robot.name, row.state, row.why, row.pattern, row.protection, row.presence, ...(row.labels || [])].join(' ').toLowerCase();
      return this.words.every((word) => text.includes(word));
    };
    const robots = [...this.model.robots.values()].filter(matches);
    const column = COLUMNS.find(([key]) => key === this.sort);
    const of = NUMBERS[this.sort] || column[2];
    const keys = new Map(robots.map((robot) => [robot, of(robot, now, this.model)]));
    robots.sort((one, other) => {
      const a = keys.get(one), b = keys.get(other);
      const order = typeof a === 'number' ? a - b : compare(a, b);
      return this.direction * (order || 0);
    });
    return robots;
  }

  draw() {
    const robots = this.chosen(), now = performance.now();
    this.shown = robots;
    const first = Math.max(0, Math.floor(this.pane.scrollTop / ROW) - 3);
    const last = Math.min(robots.length, first + Math.ceil(this.pane.clientHeight / ROW) + 6);
    const parts = [spacer(first * ROW)]; // only what is seen
    robots.slice(first, last).forEach((robot, i) => parts.push(this.row(robot, now, first + i)));
    parts.push(spacer((robots.length - last) * ROW));
    this.body.replaceChildren(...parts);
    this.body.parentElement.setAttribute('aria-rowcount', robots.length + 1);
  }

  row(robot, now, index) {
    const row = document.createElement('tr');
    row.dataset.name = robot.name;
    row.setAttribute('aria-selected', this.model.selected.has(robot.name));
    row.setAttribute('aria-rowindex', index + 2);
    if (!this.model.isHeard(robot, now)) row.className = 'stale';
    for (const [key, , text] of COLUMNS) {
      const cell = row.insertCell();
      const value = text(robot, now, this.model);
      cell.className = key;
      if (key === 'state') {
        const mark = document.createElement('i');
        const [colour, sign] = stateColour(row.className ? '' : robot.row.state);
        mark.style.background = colour;
        cell.append(mark, `${sign} ${value}`);
      } else cell.textContent = value;
      cell.title = value;
    }
    return row;
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
    const top = next * ROW;
    if (top < this.pane.scrollTop) this.pane.scrollTop = top;
    if (top > this.pane.scrollTop + this.pane.clientHeight - 3 * ROW) this.pane.scrollTop = top - this.pane.clientHeight + 3 * ROW;
  }
}

function spacer(height) {
  const row = document.createElement('tr');
  row.className = 'space';
  row.setAttribute('aria-hidden', 'true');
  const cell = row.insertCell();
  cell.colSpan = COLUMNS.length;
  cell.style.height = `${height}px`;
  return row;
}
