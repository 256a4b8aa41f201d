// The robots by the server's messages, and the selection that map and list share.

import { wordOf } from './states.js';

export const STALE = 5; // s without news after which a robot is shown as not heard
const TRAIL = 300; // places kept for each robot
const TRAIL_STEP = 0.02; // m between two of them
const KEPT = 300; // moments that are plotted of a living swarm
const APART = 2; // m between robots of a living swarm without a shared frame, where the page first sees them
const ACK_TIME = 3000; // ms from an acknowledgement to the status that follows, at most
const MOST = 100; // values that are plotted: robots may report under other names each second

export class Model extends EventTarget {
  constructor() {
    super();
    this.robots = new Map(); // by name
    this.byIndex = []; // as in frames
    this.selected = new Set();
    this.arena = null;
    this.source = '';
    this.role = '';
    this.swarm = '';
    this.patterns = [];
    this.reportUnits = new Map(); // by pattern, then by key
    this.runs = [];
    this.playback = null; // of recorded runs
    this.time = 0;
    this.sequence = 0; // of the last frame
    this.links = [];
    this.isConnected = false;
    this.boxes = [];
    this.plots = { times: [], values: {}, next: 0 };
    this.marks = []; // events: time, text, some of the robots, their number
    this.columns = 1; // of the layout of robots without a shared frame
    this.past = null; // the time that a living swarm is looked back at
    this.sendPast = () => {};
  }

  tell(name) { this.dispatchEvent(new Event(name)); }

  hello(message) {
    const { run } = this.playback || {};
    const isOther = message.playback && message.playback.run !== run;
    const before = isOther ? new Map() : this.robots;
    this.swarm = message.swarm;
    this.robots = new Map();
    this.byIndex = [];
    const offsets = this.offsets();
    for (const one of message.robots) this.add(one, before.get(one.name), offsets);
    const columns = Math.ceil(Math.sqrt(this.robots.size));
    if (columns !== this.columns) for (const robot of this.robots.values()) { robot.layout = null; robot.trail.length = 0; }
    this.columns = columns;
    this.arena = message.arena;
    this.source = message.source;
    this.role = message.role;
    this.key = message.key || '';
    this.patterns = message.patterns || [];
    this.reportUnits = new Map(Object.entries(message.report_units || {}));
    this.runs = message.runs;
    this.playback = message.playback;
    if (isOther) { this.boxes = []; this.marks = []; this.plots = { times: [], values: {}, next: 0 }; }
    for (const name of this.selected) if (!this.robots.has(name)) this.selected.delete(name);
    this.tell('hello');
    this.tell('selection');
  }

  add(one, before, offsets) {
    const robot = before || { trail: [], row: {}, detail: null, scan: null, heard: 0, age: Infinity, offset: offsets[one.name] || [0, 0, 0] };
    robot.name = one.name;
    robot.platform = one.platform;
    robot.footprint = one.footprint;
    robot.radius = Math.max(0.05, ...one.footprint.map(([x, y]) => Math.hypot(x, y)));
    robot.middle = [0, 1].map((axis) => one.footprint.reduce((sum, corner) => sum + corner[axis], 0) / one.footprint.length);
    robot.x = robot.x ?? NaN;
    robot.index = one.index;
    this.robots.set(one.name, robot);
    this.byIndex[one.index] = robot;
  }

  rows(message, now) {
    if (this.past !== null) { // a robot that joined later
      for (const { name, row } of this.robots.values()) {
        if (!message.rows[name]) Object.assign(row, { presence: 'absent', state: '', stands: '', lost: '' });
      }
    }
    for (const [name, row] of Object.entries(message.rows)) {
      const robot = this.robots.get(name);
      if (!robot) continue;
      Object.assign(robot.row, row);
      if (robot.acked && (row.state !== robot.acked.before || now > robot.acked.until)) robot.acked = null;
      else if (robot.acked && this.past === null) Object.assign(robot.row, robot.acked.row);
      robot.heard = now;
      robot.age = 0;
    }
    (message.ages || []).forEach((age, index) => { // of each robot, also of an unchanged one
      const robot = this.byIndex[index];
      if (!robot) return;
      robot.heard = now;
      robot.age = age ?? Infinity;
    });
    if (message.links) this.links = message.links;
    this.tell('rows');
  }

  // Values of moments that follow the earlier values, or replace them.
  plot({ first, times, values }) {
    const { plots } = this;
    if (first !== plots.next) this.plots = { times: [], values: {}, next: first };
    const before = this.plots.times.length;
    this.plots.times.push(...times);
    for (const [key, some] of Object.entries(values)) {
      if (!this.plots.values[key] && Object.keys(this.plots.values).length >= MOST) continue;
      const all = this.plots.values[key] ||= [];
      while (all.length < before) all.push(null);
      all.push(...some);
    }
    this.plots.next = first + times.length;
    const over = this.playback ? 0 : this.plots.times.length - KEPT;
    if (over > 0) {
      this.plots.times.splice(0, over);
      for (const [key, all] of Object.entries(this.plots.values)) {
        all.splice(0, over);
        if (all.every((one) => one === null)) delete this.plots.values[key];
      }
    }
    this.tell('plots');
  }

  // Look at a time of the past; null for now.
  lookAt(time) {
    if (time === this.past) return;
    this.past = time;
    this.forgetTrails();
    for (const robot of this.robots.values()) robot.scan = null;
    this.sendPast(time);
    this.tell('past');
  }

  // A frame: kind 1, sequence, time, then index, x, y, yaw of each robot that was heard.
  frame(view, now) {
    this.sequence = view.getUint32(4, true);
    this.time = view.getFloat64(8, true);
    const count = view.getUint32(16, true);
    if (this.past !== null) for (const robot of this.robots.values()) robot.x = NaN; // only those that were there
    for (let i = 0, at = 20; i < count; i++, at += 16) {
      const robot = this.byIndex[view.getUint32(at, true)];
      if (!robot) continue;
      const x = view.getFloat32(at + 4, true), y = view.getFloat32(at + 8, true);
      if (!Number.isFinite(x + y)) continue;
      robot.layout ||= this.layoutOf(robot, x, y);
      const [dx, dy, turn] = this.shiftOf(robot);
      const c = Math.cos(turn), s = Math.sin(turn);
      robot.x = dx + c * x - s * y;
      robot.y = dy + s * x + c * y;
      robot.yaw = view.getFloat32(at + 12, true) + turn;
      robot.moved = now;
      const last = robot.trail.length - 2;
      if (last < 0 || Math.hypot(robot.trail[last] - robot.x, robot.trail[last + 1] - robot.y) > TRAIL_STEP) {
        robot.trail.push(robot.x, robot.y);
        if (robot.trail.length > 2 * TRAIL) robot.trail.splice(0, robot.trail.length - 2 * TRAIL);
      }
    }
    this.tell('frame');
  }

  // Where odometry without a common origin is drawn: each robot of a living swarm begins at its place in a grid.
  layoutOf(robot, x, y) {
    if (this.source !== 'live' || this.robots.size < 2) return [0, 0, 0];
    const row = Math.floor(robot.index / this.columns), column = robot.index % this.columns;
    return [APART * column - x, -APART * row - y, 0];
  }

  // What moves a robot's odometry onto the map: the operator's alignment, else the layout.
  shiftOf(robot) { return robot.offset.some((one) => one !== 0) ? robot.offset : robot.layout || [0, 0, 0]; }

  scan(view) {
    const robot = this.byIndex[view.getUint32(4, true)];
    if (!robot) return;
    const count = view.getUint32(8, true);
    const points = new Float32Array(count * 2);
    for (let i = 0; i < 2 * count; i++) points[i] = view.getFloat32(12 + 4 * i, true);
    robot.scan = points; // in the base frame
    robot.scanned = performance.now();
    this.tell('frame');
  }

  // The unit of a report, `report:KEY`, as the patterns that report it declare; empty if they differ.
  unitOf(key) {
    const [kind, name] = key.split(/:(.*)/), units = new Set();
    for (const { row } of kind === 'report' ? this.robots.values() : []) {
      if (name in (row.report || {})) units.add((this.reportUnits.get(row.pattern) || {})[name] || '');
    }
    return units.size === 1 ? [...units][0] : '';
  }

  forgetTrails() { for (const robot of this.robots.values()) robot.trail.length = 0; }

  // Seconds since the robot was last heard; Infinity if never.
  age(robot, now) { return this.playback ? 0 : this.past !== null ? robot.age : robot.age + (now - robot.heard) / 1000; }

  isHeard(robot, now) {
    return this.isConnected && robot.row.presence === 'alive' && this.age(robot, now) < STALE;
  }

  // The state of a robot in a word; of one that is not heard `silent`, or `left` if it ended in order.
  stateOf(robot, now) {
    return this.isHeard(robot, now) ? wordOf(robot.row) : robot.row.presence === 'left' ? 'left' : 'silent';
  }

  // True while at least two robots have places that the operator has not aligned; the others are
  // aligned to one of them.
  isUnaligned() {
    const isFree = (robot) => robot.x === robot.x && robot.offset.every((value) => value === 0);
    return [...this.robots.values()].filter(isFree).length > 1;
  }

  // Robots that acknowledged an emergency stop have its state until their next status, at most `ACK_TIME`.
  acknowledge(names, state, why) {
    for (const robot of names.map((name) => this.robots.get(name))) {
      if (!robot || robot.row.state === state) continue;
      robot.acked = { row: { state, why, stands: '', at: NaN }, before: robot.row.state, until: performance.now() + ACK_TIME };
      Object.assign(robot.row, robot.acked.row);
    }
    this.tell('rows');
  }

  // The operator's alignment of a robot's odometry: x, y and yaw of its frame on the map.
  offsets() {
    try { return JSON.parse(localStorage.getItem(`frames of ${this.swarm}`)) || {}; } catch { return {}; }
  }

  keepOffsets(isForgotten) {
    const offsets = isForgotten ? {} : this.offsets();
    for (const robot of this.robots.values()) {
      if (isForgotten) { robot.offset = [0, 0, 0]; robot.layout = null; robot.trail.length = 0; }
      else if (robot.offset.some((one) => one !== 0)) offsets[robot.name] = robot.offset;
    }
    try { localStorage.setItem(`frames of ${this.swarm}`, JSON.stringify(offsets)); } catch { /* not kept */ }
  }

  select(names, adds = false) {
    if (!adds) this.selected.clear();
    for (const name of names) {
      if (adds && this.selected.has(name)) this.selected.delete(name);
      else this.selected.add(name);
    }
    for (const robot of this.robots.values()) if (!this.selected.has(robot.name)) robot.scan = null;
    this.tell('selection');
  }
}
