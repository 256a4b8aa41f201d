// The map, seen from above: robots, trails, scans of selected robots, walls and boxes.

import { addBody } from './body.js';
import { Colouring, scale } from './colours.js';
import { Gestures } from './gestures.js';
import { LOST, SHADE, colourOf, isAlarm, signOf, wordOf } from './states.js';

const LIMIT = '#d55e00'; // of an obstacle that limits a robot
const MANY = 60; // robots from which on only some trails are drawn
const NAMED = 15; // robots in view up to which all have names
const LEAST = 5; // pixels from the middle of a robot to its farthest corner, at least
const MOVABLE = '#c49c6b', CONTACT = '#d55e00'; // movable boxes; a ring around a robot in contact
const KEEP_OUT = 'rgba(213, 94, 0, 0.22)'; // areas of a fence that robots do not enter
const TRACK = '#0072b2'; // of a tracked object
const OLD = 3000; // ms after which a scan is not shown
const STEPS = [0.1, 0.5, 1, 5, 10, 50, 100, 500]; // m between two lines of the grid, and of the scale bar
const BAR = 140; // pixels of the scale bar, at most
export const ABOVE_SCALE = 30; // pixels of its height
const LEAST_ROOM = 24; // pixels: the smallest side of the part of the map in which robots are fitted
const EDGE = 0.6, WALL = 12; // m around robots, and pixels around walls, that are shown by Fit
const NEAR = 10; // pixels from an edge within which a robot leaves the map
const REFIT = 1000; // ms from one fit to the next, while nobody has moved the view
const SMALL = 16; // pixels of a robot's radius below which its sign has its colour
const BODY = 8; // pixels of a robot's radius from which on it has a bar and wheels; below, a line ahead
const DARK = '#20262d', LIGHT = '#ffffff'; // of wheels, and of bars and the edges of signs
const SIGN = 5; // pixels from the middle of a sign to its edge, at least

const SILENT_CHIP = '#cf1b3c'; // darker than on the map: white words on it have a contrast of 5.3
const MAX_NAMES = 12; // of silent robots beside their number

const short = (robots) => robots.slice(0, MAX_NAMES).map((one) => one.name).join(', ') + (robots.length > MAX_NAMES ? ' ...' : '');
const rangeOf = (rows) => [Math.min(...rows.flat()), Math.max(...rows.flat())];

export class SwarmMap {
  constructor(canvas, model) {
    this.canvas = canvas;
    this.model = model;
    this.ctx = canvas.getContext('2d');
    this.centre = [0, 0];
    this.scale = 60; // pixels a metre
    this.colouring = new Colouring('state');
    this.shows = { trails: true, links: false, names: true };
    this.mode = ''; // '', measure, align
    this.isFollowing = false;
    this.hovered = null; // the robot below the mouse
    this.nameSize = 0.78; // rem
    this.insets = [0, ABOVE_SCALE, 0, 0]; // pixels above, below, left and right that something covers
    this.corner = [0, 0]; // pixels left of the scale bar and below it that something covers
    this.fittedAt = 0;
    this.hasFitted = false;
    this.ruler = null;
    this.field = ''; // the name of the field behind the robots
    this.fieldPicture = null;
    this.floor = new Image(); // the picture of the floor, once it is loaded
    this.floor.addEventListener('load', () => this.wake());
    this.gestures = new Gestures(this);
    new ResizeObserver(() => { this.resize(); if (this.hasFitted && !this.isTouched) this.fit(); this.draw(); }).observe(canvas);
    for (const news of ['frame', 'rows', 'selection', 'hello']) model.addEventListener(news, () => this.wake());
    model.addEventListener('hello', () => { if (!this.isTouched) this.hasFitted = false; });
  }

  // Draw once at the next animation frame, after any number of changes.
  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => { this.isWaiting = false; this.draw(); });
  }

  resize() {
    const { clientWidth: w, clientHeight: h } = this.canvas;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    this.canvas.width = Math.max(1, Math.round(w * ratio));
    this.canvas.height = Math.max(1, Math.round(h * ratio));
    this.ratio = ratio;
  }

  toScreen(x, y) {
    return [this.canvas.width / 2 + (x - this.centre[0]) * this.scale * this.ratio,
      this.canvas.height / 2 - (y - this.centre[1]) * this.scale * this.ratio];
  }

  toWorld(event) {
    const box = this.canvas.getBoundingClientRect();
    return [this.centre[0] + (event.clientX - box.left - box.width / 2) / this.scale,
      this.centre[1] - (event.clientY - box.top - box.height / 2) / this.scale];
  }

  // The robots in three lists: those that are heard, those that are silent, and those that have left.
  heard() {
    const now = performance.now(), lists = [[], [], []], places = { silent: 1, left: 2 };
    for (const robot of this.model.robots.values()) lists[places[this.model.stateOf(robot, now)] || 0].push(robot);
    return lists;
  }

  // The entries of the states, alarms first, with the names of silent robots.
  states() {
    const [heard, silent, left] = this.heard(), found = new Colouring('state').legend(heard, '');
    if (silent.length) found.unshift({ colour: SILENT_CHIP, text: 'silent', sign: signOf('silent'), robots: silent, names: short(silent) });
    const lost = heard.filter((one) => one.row.lost);
    if (lost.length) found.push({ colour: LOST, text: 'base lost', line: 'ring', robots: lost });
    if (left.length) found.push({ colour: colourOf('left'), text: 'left', sign: signOf('left'), robots: left });
    return found.map((one) => ({ ...one, look: isAlarm(one.text) ? 'alarm' : '' }));
  }

  // The entries of the legend: colours and their meanings. `look`: of entries that `states` has, too.
  legend() {
    const [heard, silent, left] = this.heard(), isState = this.colouring.key === 'state';
    const found = this.colouring.legend(heard, this.model.unitOf(this.colouring.key));
    if (isState) for (const one of found) one.look = 'state';
    if (silent.length) found.unshift({ colour: colourOf('silent'), text: 'silent', line: 'dashed', robots: silent, look: 'state' });
    const mark = (colour, text, line, robots, look) => { if (robots.length) found.push({ colour, text, line, robots, look }); };
    if (!isState) { // the signs are on the map whatever the colours mean
      for (const [word, sign] of [['estopped', '\u2716'], ['stopped', '\u25a0'], ['held', '\u2016'], ['faulted', '\u26a0']]) {
        const robots = heard.filter((one) => wordOf(one.row) === word);
        if (robots.length) found.push({ colour: 'transparent', text: word, sign, robots, look: 'state' });
      }
    }
    mark(colourOf('left'), 'left', 'dashed', left, 'state');
    mark(LOST, 'base lost', 'ring', heard.filter((one) => one.row.lost), 'state');
    mark(CONTACT, 'in contact', 'ring', heard.filter((one) => one.row.touches));
    if (this.chosen().some((one) => (one.row.rows || []).length)) found.push({ colour: LIMIT, text: 'limits it', line: 'arc' });
    const fences = this.fencesOf();
    if (fences.length) found.push({ colour: 'transparent', text: 'fence', line: 'fence' });
    if (fences.some((polygons) => polygons.length > 1)) found.push({ colour: KEEP_OUT, text: 'keep out', line: 'fence' });
    if (this.fieldPicture && this.colouring.key !== `readings:${this.field}`) {
      const [low, high] = rangeOf(this.model.arena.fields[this.field]);
      found.push({ colour: scale(0), text: `${this.field} ${low.toPrecision(3)}` }, { colour: scale(1), text: `${this.field} ${high.toPrecision(3)}` });
    }
    return found;
  }

  // Readings of a field use the colours of that field.
  colourBy(key) {
    const field = ((this.model.arena || {}).fields || {})[key.replace(/^readings:/, '')];
    this.colouring = new Colouring(key, ...(field && key.startsWith('readings:') ? rangeOf(field) : []));
    this.wake();
  }

  // The field behind the robots: an image with a pixel for each cell, scaled from lowest to highest value.
  showField(name) {
    const values = name && this.model.arena.fields[name];
    this.field = name;
    this.fieldPicture = null;
    if (values) {
      const [low, high] = rangeOf(values);
      const picture = document.createElement('canvas');
      [picture.width, picture.height] = [values[0].length, values.length];
      const ctx = picture.getContext('2d');
      values.forEach((row, y) => row.forEach((value, x) => {
        ctx.fillStyle = scale((value - low) / Math.max(high - low, 1e-9));
        ctx.fillRect(x, y, 1, 1); // the first row has the lowest y, as the map's own axes
      }));
      this.fieldPicture = picture;
    }
    this.wake();
  }

  fit() {
    let [left, bottom, right, top] = [Infinity, Infinity, -Infinity, -Infinity];
    const take = (x, y) => {
      left = Math.min(left, x); right = Math.max(right, x);
      bottom = Math.min(bottom, y); top = Math.max(top, y);
    };
    for (const robot of this.model.robots.values()) if (robot.x === robot.x) take(robot.x, robot.y);
    const arena = this.model.arena;
    for (const [outer] of this.fencesOf()) for (const [x, y] of outer) take(x, y);
    if (arena) { take(-arena.size[0] / 2, -arena.size[1] / 2); take(arena.size[0] / 2, arena.size[1] / 2); }
    if (left > right) return;
    const { clientWidth: w, clientHeight: h } = this.canvas, [above, below, before, after] = this.insets;
    const [edge, wall] = arena ? [0, 2 * WALL] : [EDGE, 0];
    this.scale = Math.min(Math.max(w - before - after - wall, LEAST_ROOM) / (right - left + 2 * edge), Math.max(h - above - below - wall, LEAST_ROOM) / (top - bottom + 2 * edge), 220);
    this.centre = [(left + right) / 2 + (after - before) / 2 / this.scale, (bottom + top) / 2 + (above - below) / 2 / this.scale];
    this.fittedAt = performance.now();
    this.hasFitted = true;
    this.isTouched = false; // until then, robots that join move the view
    this.wake();
  }

  // True if a robot is outside of the part of the map that nothing covers.
  isLeft(robots) {
    const { clientWidth: w, clientHeight: h } = this.canvas, [above, below, before, after] = this.insets;
    return robots.some((robot) => {
      const [x, y] = this.toScreen(robot.x, robot.y).map((one) => one / this.ratio);
      return x < before + NEAR || x > w - after - NEAR || y < above + NEAR || y > h - below - NEAR;
    });
  }

  follow() {
    const known = this.chosen();
    if (!known.length) return;
    this.centre = [known.reduce((sum, one) => sum + one.x, 0) / known.length,
      known.reduce((sum, one) => sum + one.y, 0) / known.length];
  }

  draw() {
    const { ctx, model } = this;
    if (!this.ratio) this.resize();
    if (!this.hasFitted && [...model.robots.values()].some((one) => one.x === one.x)) this.fit();
    if (this.isFollowing) this.follow();
    const robots = [...model.robots.values()].filter((one) => one.x === one.x), now = performance.now();
    if (this.hasFitted && !this.isTouched && !this.isFollowing && !this.mode && now - this.fittedAt > REFIT && this.isLeft(robots)) this.fit();
    const style = getComputedStyle(document.documentElement);
    const [line, text, dim, back] = ['--line', '--text', '--dim', '--pane'].map((name) => style.getPropertyValue(name));
    const zoom = this.scale * this.ratio;
    this.rem = parseFloat(style.fontSize) * this.ratio; // texts grow with those of the page
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    ctx.fillStyle = back;
    ctx.fillRect(0, 0, this.canvas.width, this.canvas.height);
    ctx.setTransform(zoom, 0, 0, -zoom,
      this.canvas.width / 2 - this.centre[0] * zoom, this.canvas.height / 2 + this.centre[1] * zoom);
    this.grid(line, zoom);
    this.walls(text, dim, zoom);
    this.fences(text, zoom);
    if (this.shows.links) this.drawLinks(dim, zoom);
    if (this.shows.trails) this.drawTrails(robots, zoom);
    for (const robot of robots) if (model.selected.has(robot.name) && robot.scan && now - robot.scanned < OLD) this.drawScan(robot, zoom);
    for (const robot of robots) if (model.selected.has(robot.name)) this.drawLimits(robot, zoom);
    this.drawRobots(robots, now, zoom, text);
    for (const robot of robots) if (model.selected.has(robot.name)) this.drawTracks(robot, zoom);
    ctx.setTransform(1, 0, 0, 1, 0, 0);
    this.drawNames(this.named(robots), text, dim, back);
    this.drawScale(text, back);
    if (this.ruler) this.drawRuler(text);
  }

  grid(line, zoom) {
    const { ctx } = this;
    // Bound the number of grid lines: a robot may report a pose 1e9 m away.
    const step = STEPS.find((one) => one * this.scale >= 45)
      || 10 ** Math.ceil(Math.log10(45 / this.scale));
    const [w, h] = [this.canvas.width / zoom / 2, this.canvas.height / zoom / 2];
    ctx.lineWidth = 1 / zoom;
    ctx.strokeStyle = line;
    ctx.beginPath();
    for (let i = 0; i <= 2 * w / step; i++) {
      const x = (Math.ceil((this.centre[0] - w) / step) + i) * step;
      ctx.moveTo(x, this.centre[1] - h); ctx.lineTo(x, this.centre[1] + h);
    }
    for (let i = 0; i <= 2 * h / step; i++) {
      const y = (Math.ceil((this.centre[1] - h) / step) + i) * step;
      ctx.moveTo(this.centre[0] - w, y); ctx.lineTo(this.centre[0] + w, y);
    }
    ctx.stroke();
  }

  walls(text, dim, zoom) {
    const { ctx } = this, { arena, boxes } = this.model;
    if (!arena) return;
    const [left, bottom] = [-arena.size[0] / 2, -arena.size[1] / 2];
    const floor = arena.floor || '';
    if ((this.floor.getAttribute('src') || '') !== floor) this.floor.src = floor;
    if (floor && this.floor.complete && this.floor.naturalWidth) {
      ctx.save();
      ctx.scale(1, -1); // its first row is the top one
      ctx.imageSmoothingEnabled = false;
      ctx.globalAlpha = 0.6;
      ctx.drawImage(this.floor, left, bottom, ...arena.size);
      ctx.restore();
    }
    if (this.fieldPicture) {
      ctx.globalAlpha = 0.45;
      ctx.drawImage(this.fieldPicture, left, bottom, ...arena.size);
      ctx.globalAlpha = 1;
    }
    ctx.lineWidth = 2 * this.ratio / zoom;
    ctx.strokeStyle = text;
    ctx.strokeRect(left, bottom, ...arena.size);
    ctx.fillStyle = dim;
    const shape = (points) => {
      ctx.beginPath();
      points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
      ctx.closePath();
      ctx.fill();
    };
    for (const points of arena.shapes || []) shape(points);
    ctx.lineWidth = this.ratio / zoom;
    ctx.fillStyle = MOVABLE;
    for (const box of boxes) {
      const [x, y, yaw] = box.pose, c = Math.cos(yaw), s = Math.sin(yaw);
      shape(box.shape.map(([u, v]) => [x + c * u - s * v, y + s * u + c * v]));
      ctx.stroke();
    }
    ctx.fillStyle = dim;
    for (const [x, y, radius] of arena.poles || []) {
      ctx.beginPath();
      ctx.arc(x, y, radius, 0, 2 * Math.PI);
      ctx.fill();
    }
  }

  // The different fences of robots, each a list of polygons, the outer one first.
  fencesOf() {
    const all = [...this.model.robots.values()].map((one) => one.row.fence).filter((one) => one);
    return [...new Map(all.map((one) => [JSON.stringify(one), one])).values()];
  }

  // The fences: dashed, the areas to keep out of filled.
  fences(text, zoom) {
    const { ctx } = this;
    ctx.strokeStyle = text;
    ctx.fillStyle = KEEP_OUT;
    ctx.lineWidth = 2 * this.ratio / zoom;
    ctx.setLineDash([8 * this.ratio / zoom, 6 * this.ratio / zoom]);
    for (const polygons of this.fencesOf()) {
      polygons.forEach((points, number) => {
        ctx.beginPath();
        points.forEach(([x, y], i) => (i ? ctx.lineTo(x, y) : ctx.moveTo(x, y)));
        ctx.closePath();
        if (number) ctx.fill();
        ctx.stroke();
      });
    }
    ctx.setLineDash([]);
  }

  drawLinks(dim, zoom) {
    const { ctx, model } = this;
    ctx.strokeStyle = dim;
    ctx.globalAlpha = 0.5;
    ctx.lineWidth = this.ratio / zoom;
    ctx.beginPath();
    for (const [a, b] of model.links) {
      const one = model.byIndex[a], other = model.byIndex[b];
      if (!one || !other || one.x !== one.x || other.x !== other.x) continue;
      ctx.moveTo(one.x, one.y);
      ctx.lineTo(other.x, other.y);
    }
    ctx.stroke();
    ctx.globalAlpha = 1;
  }

  // With many robots: trails of selected robots, or only the last few places.
  drawTrails(robots, zoom) {
    const { ctx, model } = this, paths = new Map();
    const isMany = robots.length > MANY, some = isMany && model.selected.size;
    const length = isMany && !some ? 12 : 600;
    for (const robot of some ? this.chosen() : robots) {
      const { trail } = robot;
      if (trail.length < 4) continue;
      const colour = this.colouring.of(robot);
      if (!paths.has(colour)) paths.set(colour, new Path2D());
      const path = paths.get(colour), first = Math.max(0, trail.length - length);
      path.moveTo(trail[first], trail[first + 1]);
      for (let i = first + 2; i < trail.length; i += 2) path.lineTo(trail[i], trail[i + 1]);
      path.lineTo(robot.x, robot.y);
    }
    ctx.lineWidth = 1.5 * this.ratio / zoom;
    ctx.globalAlpha = 0.6;
    for (const [colour, path] of paths) {
      ctx.strokeStyle = colour;
      ctx.stroke(path);
    }
    ctx.globalAlpha = 1;
  }

  drawScan(robot, zoom) {
    const { ctx } = this, c = Math.cos(robot.yaw), s = Math.sin(robot.yaw), size = 3 * this.ratio / zoom;
    ctx.fillStyle = this.colouring.of(robot);
    for (let i = 0; i < robot.scan.length; i += 2) {
      const u = robot.scan[i], v = robot.scan[i + 1];
      ctx.fillRect(robot.x + c * u - s * v - size / 2, robot.y + s * u + c * v - size / 2, size, size);
    }
  }

  // The obstacles that limit a robot: their places, and a line to each.
  drawLimits(robot, zoom) {
    const { ctx } = this;
    ctx.strokeStyle = LIMIT;
    for (const [bearing, gap] of robot.row.rows || []) {
      const far = edge(robot.footprint, bearing) + Math.max(gap, 0), angle = robot.yaw + bearing;
      const [x, y] = [robot.x + far * Math.cos(angle), robot.y + far * Math.sin(angle)];
      ctx.lineWidth = 1.5 * this.ratio / zoom;
      ctx.beginPath();
      ctx.moveTo(robot.x, robot.y);
      ctx.lineTo(x, y);
      ctx.stroke();
      ctx.lineWidth = 5 * this.ratio / zoom;
      ctx.beginPath();
      ctx.arc(robot.x, robot.y, far, angle - 0.25, angle + 0.25);
      ctx.stroke();
    }
  }

  // The objects that a robot tracks: a circle, a line to the place in one second, and the name.
  drawTracks(robot, zoom) {
    const { ctx } = this, c = Math.cos(robot.yaw), s = Math.sin(robot.yaw);
    ctx.strokeStyle = TRACK;
    ctx.lineWidth = 1.5 * this.ratio / zoom;
    ctx.beginPath();
    const names = [];
    for (const [u, v, vx, vy, radius, name] of robot.row.tracks || []) {
      const x = robot.x + c * u - s * v, y = robot.y + s * u + c * v;
      ctx.moveTo(x + radius, y);
      ctx.arc(x, y, radius, 0, 2 * Math.PI);
      ctx.moveTo(x, y);
      ctx.lineTo(x + c * vx - s * vy, y + s * vx + c * vy);
      if (name) names.push([name, x + radius, y]);
    }
    ctx.stroke();
    ctx.save();
    ctx.setTransform(1, 0, 0, 1, 0, 0); // text is not turned
    ctx.fillStyle = TRACK;
    ctx.font = `${0.8 * this.rem}px system-ui, sans-serif`;
    ctx.textAlign = 'left';
    for (const [name, x, y] of names) ctx.fillText(name, ...this.toScreen(x, y));
    ctx.restore();
  }

  // One path for each colour is drawn faster than one path for each robot.
  drawRobots(robots, now, zoom, text) {
    const { ctx, model } = this, filled = new Map(), unheard = { silent: new Path2D(), left: new Path2D() }, heads = new Path2D();
    const bars = new Path2D(), wheels = new Path2D(), touched = new Path2D(), chosen = new Path2D(), lost = new Path2D(), shaded = new Map(), signs = new Map();
    const ring = (path, x, y, radius) => { path.moveTo(x + radius, y); path.arc(x, y, radius, 0, 2 * Math.PI); };
    for (const robot of robots) {
      const { x, y, radius } = robot, isHeard = model.isHeard(robot, now);
      const grown = Math.max(1, LEAST * this.ratio / (radius * zoom)); // far away: larger than it is
      const c = grown * Math.cos(robot.yaw), s = grown * Math.sin(robot.yaw);
      const word = model.stateOf(robot, now);
      let path = unheard[word];
      if (isHeard) {
        const colour = this.colouring.of(robot), paths = word === 'at rest' ? shaded : filled;
        path = paths.get(colour);
        if (!path) paths.set(colour, path = new Path2D());
        if (robot.row.lost) ring(lost, x, y, 1.4 * radius * grown);
      }
      const sign = SIGNS[word];
      if (sign) {
        const look = !isHeard || radius * this.scale < SMALL ? isHeard ? this.colouring.of(robot) : colourOf(word) : '';
        if (!signs.has(look)) signs.set(look, new Path2D());
        const [u, v] = robot.middle;
        sign(signs.get(look), x + c * u - s * v, y + s * u + c * v, Math.max(0.7 * radius, SIGN * this.ratio / zoom));
      }
      robot.footprint.forEach(([u, v], i) => path[i ? 'lineTo' : 'moveTo'](x + c * u - s * v, y + s * u + c * v));
      path.closePath();
      if (isHeard && radius * grown * this.scale >= BODY) addBody(bars, wheels, robot, c, s);
      else {
        const head = isHeard ? heads : unheard[word];
        head.moveTo(x, y);
        head.lineTo(x + 1.6 * radius * c, y + 1.6 * radius * s);
      }
      if (model.selected.has(robot.name)) ring(chosen, x, y, 1.5 * radius * grown);
      if (robot.row.touches) ring(touched, x, y, 1.25 * radius * grown);
    }
    const stroke = (path, width, colour) => {
      ctx.lineWidth = width * this.ratio / zoom;
      ctx.strokeStyle = colour;
      ctx.stroke(path);
    };
    for (const [colour, path] of shaded) {
      ctx.globalAlpha = SHADE;
      ctx.fillStyle = colour;
      ctx.fill(path);
      ctx.globalAlpha = 1;
      stroke(path, 3, colour);
    }
    for (const [colour, path] of filled) {
      ctx.fillStyle = colour;
      ctx.fill(path);
      stroke(path, 1, text);
    }
    for (const [path, colour, edge] of [[wheels, DARK, LIGHT], [bars, LIGHT, DARK]]) {
      ctx.fillStyle = colour;
      ctx.fill(path);
      stroke(path, 0.6, edge);
    }
    stroke(heads, 2, text);
    ctx.setLineDash([5 * this.ratio / zoom, 3 * this.ratio / zoom]);
    for (const [word, path] of Object.entries(unheard)) stroke(path, 3, colourOf(word)); // an empty outline where it was last
    ctx.setLineDash([]);
    for (const [colour, path] of signs) { // a dark sign, of a small robot in its colour, with a light edge
      stroke(path, 5, LIGHT);
      stroke(path, 2.5, colour || '#16191d');
    }
    stroke(lost, 4, LOST);
    stroke(chosen, 3, text);
    stroke(touched, 4, CONTACT);
  }

  // Names of the robots in view if they are few, else of selected robots; always of the robot below the mouse.
  named(robots) {
    const [w, h] = [this.canvas.clientWidth / this.scale / 2, this.canvas.clientHeight / this.scale / 2];
    const seen = robots.filter((one) => Math.abs(one.x - this.centre[0]) < w && Math.abs(one.y - this.centre[1]) < h);
    const isAll = this.shows.names && seen.length <= NAMED;
    const some = isAll ? seen : seen.filter((one) => this.model.selected.has(one.name)).slice(0, MANY);
    return !this.hovered || some.includes(this.hovered) ? some : [...some, this.hovered];
  }

  drawNames(robots, text, dim, back) {
    const { ctx } = this;
    ctx.lineJoin = 'round';
    ctx.font = `${this.nameSize * this.rem}px system-ui, sans-serif`;
    ctx.textAlign = 'center';
    ctx.textBaseline = 'middle';
    const size = this.nameSize * this.rem, high = 0.55 * size;
    const isMarked = (robot) => robot === this.hovered || this.model.selected.has(robot.name);
    const reach = (robot) => Math.max(robot.radius * this.scale, LEAST) * this.ratio;
    const taken = robots.map((robot) => [...this.toScreen(robot.x, robot.y), 0.7 * reach(robot), 0.7 * reach(robot)]);
    for (const robot of [...robots].sort((one, other) => isMarked(other) - isMarked(one))) {
      const [x, y] = this.toScreen(robot.x, robot.y), far = reach(robot) * (isMarked(robot) || robot.row.lost ? 1.5 : 1); // its ring
      const word = robot === this.hovered ? ` ${this.model.stateOf(robot, performance.now())}` : '';
      const half = ctx.measureText(robot.name + word).width / 2, beside = far + half + 0.4 * size;
      // A name is put below, above or beside its robot, where it covers no robot and no name; else it is left out.
      const places = [[x, y + far + 0.9 * size], [x, y - far - 0.8 * size], [x + beside, y], [x - beside, y]];
      const isFree = ([u, v]) => taken.every(([a, b, width, height]) => Math.abs(u - a) > half + width || Math.abs(v - b) > high + height);
      const place = places.find(isFree) || (isMarked(robot) ? places[0] : null);
      if (!place) continue;
      taken.push([...place, half, high]);
      ctx.lineWidth = 3 * this.ratio;
      ctx.strokeStyle = back;
      ctx.strokeText(robot.name + word, ...place); // readable on trails and other robots
      const state = this.model.stateOf(robot, performance.now());
      ctx.fillStyle = state === 'left' ? colourOf(state) : isMarked(robot) || state === 'silent' ? text : dim; // red is fainter than the other names
      ctx.fillText(robot.name + word, ...place);
    }
    ctx.textBaseline = 'alphabetic';
  }

  // The scale bar above the legend, with a round length.
  drawScale(text, back) {
    const { ctx, ratio } = this, length = STEPS.findLast((step) => step * this.scale <= BAR) || STEPS[0];
    const width = length * this.scale * ratio, y = this.canvas.height - (this.corner[1] + 10) * ratio, x = (this.corner[0] + 12) * ratio;
    if (y < (this.insets[0] + 40) * ratio) return; // a sheet leaves no room
    ctx.beginPath();
    ctx.moveTo(x, y - 4 * ratio); ctx.lineTo(x, y); ctx.lineTo(x + width, y); ctx.lineTo(x + width, y - 4 * ratio);
    ctx.textAlign = 'left';
    ctx.font = `${0.72 * this.rem}px system-ui, sans-serif`;
    for (const [colour, thick] of [[back, 5], [text, 2]]) {
      ctx.strokeStyle = colour;
      ctx.lineWidth = thick * ratio;
      ctx.stroke();
      if (colour === back) ctx.strokeText(`${length} m`, x, y - 7 * ratio);
    }
    ctx.fillStyle = text;
    ctx.fillText(`${length} m`, x, y - 7 * ratio);
  }

  drawRuler(text) {
    const { ctx } = this, [from, to] = this.ruler;
    const [a, b] = [this.toScreen(...from), this.toScreen(...to)];
    ctx.strokeStyle = ctx.fillStyle = text;
    ctx.lineWidth = 2 * this.ratio;
    ctx.beginPath();
    ctx.moveTo(...a);
    ctx.lineTo(...b);
    ctx.stroke();
    ctx.font = `${0.9 * this.rem}px system-ui, sans-serif`;
    ctx.textAlign = 'left';
    ctx.fillText(`${Math.hypot(to[0] - from[0], to[1] - from[1]).toFixed(2)} m`, b[0] + 8, b[1] - 8);
  }

  // The selected robots whose place is known.
  chosen() {
    return [...this.model.selected].map((name) => this.model.robots.get(name)).filter((one) => one && one.x === one.x);
  }
}

// The signs of robots that stand against their will, and of silent robots, as paths around a place; each has its own shape.
const SIGNS = {
  silent(path, x, y, size) { // a question mark
    path.moveTo(x - 0.4 * size, y + 0.45 * size);
    path.arc(x, y + 0.45 * size, 0.4 * size, Math.PI, -0.4 * Math.PI, true);
    path.lineTo(x, y - 0.3 * size);
    path.moveTo(x, y - 0.75 * size); path.lineTo(x, y - 0.85 * size);
  },
  estopped(path, x, y, size) {
    path.moveTo(x - size, y - size); path.lineTo(x + size, y + size);
    path.moveTo(x - size, y + size); path.lineTo(x + size, y - size);
  },
  stopped(path, x, y, size) { path.rect(x - 0.6 * size, y - 0.6 * size, 1.2 * size, 1.2 * size); },
  held(path, x, y, size) {
    for (const side of [-0.35, 0.35]) { path.moveTo(x + side * size, y - 0.7 * size); path.lineTo(x + side * size, y + 0.7 * size); }
  },
  faulted(path, x, y, size) {
    path.moveTo(x, y + 0.9 * size); path.lineTo(x + 0.8 * size, y - 0.6 * size); path.lineTo(x - 0.8 * size, y - 0.6 * size); path.closePath();
  },
};

// Distance in m from the axle to the outline of a footprint in a direction.
function edge(footprint, bearing) {
  const [c, s] = [Math.cos(bearing), Math.sin(bearing)];
  let far = 0;
  footprint.forEach(([x1, y1], i) => {
    const [x2, y2] = footprint[(i + 1) % footprint.length];
    const [a, b] = [c * y1 - s * x1, c * y2 - s * x2]; // to the left of the ray
    if ((a > 0) === (b > 0) || a === b) return;
    const t = a / (a - b);
    far = Math.max(far, c * (x1 + t * (x2 - x1)) + s * (y1 + t * (y2 - y1)));
  });
  return far;
}
