// A stick that drives the selected robot by hand: touch, pen, mouse or arrow keys.

import { reasonOf, wordOf } from './states.js';

const PERIOD = 100; // ms between two words
const REST = 0.12; // of the radius, within which the stick rests
const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };
const element = (id) => document.getElementById(id);

export class Stick {
  // `send` returns false without a link.
  constructor(model, send) {
    Object.assign(this, { model, send, robot: '', isHeld: false, order: 0, at: [0, 0], keys: new Set(), slides: false });
    this.stick = element('stick');
    element('drive').addEventListener('click', () => this.take());
    element('release').addEventListener('click', () => this.word('release'));
    element('slide').addEventListener('click', () => this.slide(!this.slides));
    this.stick.addEventListener('pointerdown', (event) => this.down(event));
    this.stick.addEventListener('pointermove', (event) => this.move(event));
    this.stick.addEventListener('pointerup', (event) => this.up(event));
    this.stick.addEventListener('pointercancel', () => this.lose());
    this.stick.addEventListener('contextmenu', (event) => event.preventDefault());
    this.stick.addEventListener('keydown', (event) => this.key(event, true));
    this.stick.addEventListener('keyup', (event) => this.key(event, false));
    this.stick.addEventListener('blur', () => { this.keys.clear(); if (this.pointer === undefined) this.to(0, 0); });
    document.addEventListener('visibilitychange', () => { if (document.hidden) this.lose(); });
    addEventListener('pagehide', () => this.lose());
    for (const news of ['selection', 'rows', 'hello', 'detail']) model.addEventListener(news, () => this.draw());
    setInterval(() => this.tick(), PERIOD);
  }

  take() {
    const name = [...this.model.selected].at(-1);
    if (!name || this.robot) return;
    this.robot = name;
    this.order = 0;
    this.tell('');
    if (!this.send({ kind: 'hand', do: 'take', robot: name, seen: this.model.sequence })) { this.robot = ''; this.tell('No link to the server.'); }
    this.draw();
  }

  word(what) { this.send({ kind: 'hand', do: what, seen: this.model.sequence }); }

  // Lost, not released: the robot holds its run.
  lose() {
    this.rest();
    if (!this.isHeld) return;
    this.isHeld = false;
    this.word('lost');
    this.draw();
  }

  // What the server tells of this page's hand.
  answer({ is_held: isHeld, text }) {
    this.isHeld = isHeld && !document.hidden && this.robot !== '';
    if (isHeld && !this.isHeld) this.word('lost');
    if (!isHeld) this.robot = '';
    this.slide(false);
    this.rest();
    this.tell(text);
    this.draw();
    if (this.isHeld) this.stick.focus({ preventScroll: true });
  }

  disconnected() {
    if (this.robot) this.tell('No link to the server: the hand is lost.');
    Object.assign(this, { robot: '', isHeld: false });
    this.rest();
    this.draw();
  }

  tell(text) {
    element('hand-text').textContent = text;
    element('hand-text').hidden = !text;
  }

  down(event) {
    if (!this.isHeld || this.pointer !== undefined) return;
    this.pointer = event.pointerId;
    this.stick.setPointerCapture(event.pointerId);
    this.move(event);
  }

  move(event) {
    if (event.pointerId !== this.pointer) return;
    const { left, top, width } = this.stick.getBoundingClientRect();
    const [x, y] = [event.clientX - left, event.clientY - top].map((one) => (2 * one) / width - 1);
    const far = Math.max(Math.hypot(x, y), 1);
    this.to(-y / far, -x / far);
  }

  up(event) {
    if (event.pointerId !== this.pointer) return;
    this.pointer = undefined;
    this.to(0, 0);
    this.tick(); // zero at once
  }

  key(event, isDown) {
    if (!KEYS[event.key] || !this.isHeld) return;
    event.preventDefault();
    event.stopPropagation();
    if (isDown) this.keys.add(event.key); else this.keys.delete(event.key);
    const sum = [...this.keys].reduce(([a, b], key) => [a + KEYS[key][0], b + KEYS[key][1]], [0, 0]);
    this.to(...sum);
    if (!isDown) this.tick();
  }

  // Of a base that can move sideways: left and right slide, in place of a turn.
  slide(isOn) {
    this.slides = isOn;
    element('slide').setAttribute('aria-pressed', String(isOn));
  }

  rest() { this.pointer = undefined; this.keys.clear(); this.to(0, 0); }

  to(ahead, left) {
    this.at = Math.hypot(ahead, left) < REST ? [0, 0] : [ahead, left];
    element('knob').style.transform = `translate(${-50 * 1.5 * this.at[1]}%, ${-50 * 1.5 * this.at[0]}%)`;
  }

  // Ten words a second while the robot is held, also while the stick rests: without them the hand is lost.
  tick() {
    if (!this.isHeld || document.hidden) return;
    const limits = this.model.robots.get(this.robot)?.row.limits;
    const [linear, angular, lateral] = limits || [0, 0, 0];
    const turn = this.slides ? 0 : this.at[1] * angular, left = this.slides ? this.at[1] * lateral : 0;
    this.order += 1;
    this.send({ kind: 'hand', do: 'move', order: this.order, forward: this.at[0] * linear, turn, left, seen: this.model.sequence });
  }

  draw() {
    const name = this.robot || [...this.model.selected].at(-1), robot = this.model.robots.get(name);
    const isThere = robot && this.model.isHeard(robot, performance.now()) && this.model.past === null && !this.model.playback;
    element('drive').hidden = !isThere || this.robot !== '' || Boolean(robot.row.driven_by);
    element('hand').hidden = !this.isHeld;
    if (!this.isHeld || !robot) return;
    element('slide').hidden = !robot.row.limits?.[2];
    const { safe, requested } = robot.row, isStill = safe && safe.every((one) => one === 0), asks = this.at.some((one) => one !== 0);
    const held = isStill && asks && requested ? ` does not move: ${reasonOf(robot.row, this.model.time) || wordOf(robot.row)}` : '';
    element('hand-why').textContent = `${name}: ${robot.row.driven_by ? `driven by ${robot.row.driven_by}` : 'waits'}${held}`;
  }
}
