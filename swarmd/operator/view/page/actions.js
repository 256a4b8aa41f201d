// Commands to robots. The emergency stop never asks.

import { Answers, made } from './answers.js';
import { PatternForm } from './patterns.js';
import { ago, plain } from './states.js';

const COMMANDS = ['run-open', 'reset', 'detail-reset', 'estop-reset', 'run', 'param', 'set-labels', 'push']; // all but stops
const RESET = ['estopped', 'faulted']; // states that a reset ends
const MAX_SHORT = 8; // letters of a robot's name on a button
const MAX_NAMED = 3; // robots that the banner names
const CONFIRM = 5000; // ms in which the second click on a reset counts
const MAX_PUSHED = 1024 * 1024; // bytes of a pattern; of a larger file the server only tells the size
const PIECE = 24 * 1024; // bytes of a message
const element = (id) => document.getElementById(id);
let last = 0;

export class Actions {
  // `send(message)`: false without a link. `ran()`: after a run that all robots applied.
  constructor(model, send, ran) {
    Object.assign(this, { model, send, ran });
    this.waiting = new Map(); // fields of commands without a final answer, by id
    this.answers = new Answers((proposal, button) => this.propose(proposal, button));
    this.form = new PatternForm(model);
    const on = (id, act) => element(id).addEventListener('click', act);
    on('estop', () => this.estop());
    on('stop', () => this.act('stop', { targets: this.chosen() }));
    on('reset', () => this.reset(this.named(), element('reset')));
    on('estop-reset', () => this.reset(this.estoppedNames(), element('estop-reset')));
    on('run-open', () => { if (this.isPast()) this.act('run', {}); });
    on('param', () => {
      if (element('run-form').reportValidity()) this.act('param', { targets: this.named(), params: this.form.params() });
    });
    on('estop-end', () => (this.isStopping ? this.send({ kind: 'act', id: '', verb: 'end_estop' }) : this.hideEstop()));
    element('run-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const { chosen } = this.form;
      if (chosen) this.act('run', { targets: this.named(), pattern: chosen.name, params: this.form.params() });
      else element('pattern').focus();
    });
    element('label-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const labels = element('labels').value.trim();
      if (labels) this.act('label', { targets: this.named(), labels });
      else element('labels').focus();
    });
    element('push-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const [file] = element('push-file').files;
      if (file) this.push(file);
      else element('push-file').click();
    });
    for (const news of ['selection', 'hello', 'past']) model.addEventListener(news, () => this.show());
    model.addEventListener('hello', () => this.returned());
    for (const news of ['rows', 'past']) model.addEventListener(news, () => this.mark());
    this.show();
  }

  chosen() { return this.model.selected.size ? [...this.model.selected] : null; }

  named() { return this.chosen() || [...this.model.robots.keys()]; }

  show() {
    const count = this.model.selected.size, all = this.model.robots.size;
    this.disarm();
    const targets = count === 1 ? this.chosen()[0] : count ? `the ${count} selected robots` : `all ${all} robots`;
    const short = count > 1 ? `${count} robots` : !count ? `all ${all}` : targets.length > MAX_SHORT ? '1 robot' : targets;
    document.querySelector('.targets').textContent = targets;
    element('targets').textContent = this.isPast() ? `The map shows the past: only stops are sent, to ${targets}.` : `Commands go to ${targets}.`;
    for (const [id, verb] of [['stop', 'Stop'], ['reset', 'Reset'], ['push', 'Push to']]) element(id).textContent = `${verb} ${short}`;
    this.mark();
  }

  isPast() { return this.model.past !== null; }

  // Which buttons are of use now: in the past none but the stops, and a reset where one is needed.
  mark() {
    const isPast = this.isPast(), needs = this.needing(this.named()).length > 0;
    // A click still says why nothing is sent.
    for (const id of COMMANDS) element(id).setAttribute('aria-disabled', isPast || (id === 'reset' && !needs));
    this.drawEstop();
    // One primary action: where the banner offers the reset of the robots that need one, it is that.
    element('actions').classList.toggle('needs-reset', needs && !isPast && !this.isStopping && element('estop-reset').hidden);
  }

  needing(names) {
    return names.filter((name) => RESET.includes((this.model.robots.get(name) || { row: {} }).row.state));
  }

  // A second click confirms: a dialog would cover the button of the emergency stop.
  reset(names, button) {
    if (button === element('reset') && !this.isPast() && !this.needing(names).length) {
      last += 1;
      this.answers.show(`reset-${last}`, 'reset: not sent: no emergency stop and no fault to clear', [], true);
      return;
    }
    if (names.length > 1 && this.armed !== button) {
      this.disarm();
      this.armed = button;
      this.unarmed = button.textContent;
      button.textContent = `May all ${names.length} move? Reset`;
      button.classList.add('armed');
      this.timer = setTimeout(() => this.disarm(), CONFIRM);
      return;
    }
    this.disarm();
    this.act('reset', { targets: names });
  }

  disarm() {
    clearTimeout(this.timer);
    if (!this.armed) return;
    this.armed.textContent = this.unarmed;
    this.armed.classList.remove('armed');
    this.armed = null;
  }

  propose({ pattern, reset }, button) {
    if (reset) this.reset(reset, button);
    else if (pattern) {
      if (element('commands').hidden) element('run-open').click();
      this.form.choose(pattern);
    }
  }

  // The file goes to the server in pieces, then the command that uses it.
  async push(file) {
    const isTold = (id) => element(id).checked;
    const fields = {
      targets: this.named(), file: file.name, size: file.size, canary: isTold('push-canary') ? '1' : '', replace: isTold('push-replace'), rerun: isTold('push-rerun'),
    };
    let bytes;
    try {
      bytes = new Uint8Array(file.size > MAX_PUSHED ? 0 : await file.arrayBuffer());
    } catch { // it was moved or changed since it was chosen
      last += 1;
      this.answers.show(`push-${last}`, `push: not sent: ${file.name} cannot be read; choose it again`, [], true);
      return;
    }
    this.act('push', fields, (id) => {
      for (let offset = 0; offset < bytes.length; offset += PIECE) {
        this.send({ kind: 'file', id, offset, data: btoa(String.fromCharCode(...bytes.subarray(offset, offset + PIECE))) });
      }
    });
  }

  // `before(id)`: sends what the command needs.
  act(verb, fields, before = () => {}) {
    last += 1;
    const id = `${Date.now().toString(36)}-${last}`;
    if (this.isPast() && !['stop', 'estop'].includes(verb)) {
      this.answers.show(id, `${verb}: not sent: the map shows the past; go back to now`, [], true);
      return false;
    }
    // The number of the frame that the operator saw: if it is old, the server refuses to start motion.
    before(id);
    const isSent = this.send({ kind: 'act', id, verb, seen: this.model.sequence, ...fields });
    if (!isSent) this.answers.show(id, `${verb}: not sent: no link to the server`, [], true);
    else if (verb !== 'estop') { this.waiting.set(id, { verb, ...fields }); this.answers.show(id, `${verb} ...`); }
    return isSent;
  }

  estop() {
    const id = `estop-${Date.now().toString(36)}`;
    this.isUnsent = !this.send({ kind: 'act', id, verb: 'estop', targets: null });
    if (this.isUnsent) {
      this.showEstop('NOT SENT: no link to the server. It is sent when the link returns. Stop the robots by other means.', [], 'bad');
    } else this.estopped({ id, is_final: false, missing: [], replies: [] });
  }

  connected() { if (this.isUnsent) this.estop(); }

  lost(hasEnded) {
    for (const [id, { verb }] of this.waiting) {
      this.answers.show(id, `${verb} ... the link was lost: not known what came of it`, [], true);
    }
    this.waiting.clear();
    if (this.isStopping) {
      const text = hasEnded ? 'The server ended and repeats it no longer' : 'The link was lost, and it is not known whether the server still repeats it';
      this.isCutOff = true;
      this.showEstop(`Emergency stop: ${text}. ${this.lacking()}`, this.missing, 'bad');
    }
  }

  lacking() { return this.missing.length ? 'Not acknowledged until then:' : 'Which robots have acknowledged it is not known.'; }

  // The first `hello` of a new link; the server sends an emergency stop under way next.
  returned() {
    if (!this.isCutOff) return;
    this.isCutOff = this.isStopping = false;
    this.showEstop(`Emergency stop: the link was lost and is back, and the server repeats no emergency stop now. ${this.lacking()}`, this.missing, 'bad');
  }

  answer(message) {
    if (message.id.startsWith('estop-') && !message.is_final) return; // shown above the map
    const fields = this.waiting.get(message.id);
    this.answers.take(message, fields);
    if (!message.is_final) return;
    this.waiting.delete(message.id);
    if (fields && fields.verb === 'run' && message.is_good) { this.form.ran(fields.pattern); this.ran(); }
    if (fields && fields.verb === 'push' && message.is_good && fields.file.endsWith('.py')) this.form.has(fields.file.slice(0, -3));
  }

  // Show the emergency stop under way, which any page may have begun.
  estopped(message) {
    this.isCutOff = false;
    this.isStopping = !message.is_final;
    if (this.isStopping) this.answers.show(message.id, 'estop: waits for acknowledgements ...'); // not the answer before
    else this.answers.take(message);
    const applied = message.replies.filter(([, code]) => code === 'applied').map(([name]) => name);
    const others = [...this.model.robots.values()].filter((robot) => this.model.isHeard(robot, performance.now()) && !message.missing.includes(robot.name));
    this.model.acknowledge(message.is_final ? applied : message.missing.length ? others.map((robot) => robot.name) : [], 'estopped', 'emergency stop');
    this.missing = message.missing;
    const lacks = message.missing.length;
    if (message.is_final) {
      const text = message.is_good ? `${message.line}: all have acknowledged.` : `${message.line}.`;
      this.showEstop(text, message.missing, message.is_good ? 'good' : 'bad');
    } else {
      const text = lacks ? `not acknowledged by ${lacks === 1 ? '1 robot' : `${lacks} robots`}; repeated until then:` : 'sent; waits for acknowledgements ...';
      this.showEstop(`Emergency stop: ${text}`, message.missing, lacks ? 'bad' : '');
    }
  }

  showEstop(text, missing, className) {
    this.told = { text, className };
    element('estop-missing').replaceChildren(...missing.map((name) => {
      const item = made('li', ''), button = made('button', name);
      button.type = 'button';
      button.addEventListener('click', () => this.model.select([name]));
      item.append(button);
      return item;
    }));
    this.drawEstop();
  }

  hideEstop() {
    this.told = null;
    this.isUnsent = false;
    this.drawEstop();
  }

  estoppedNames() {
    return [...this.model.robots.values()].filter(({ row }) => row.state === 'estopped' && row.presence !== 'left').map((one) => one.name);
  }

  // The banner: the emergency stop under way, or what came of it; then the one that stands, until a reset.
  drawEstop() {
    const names = this.estoppedNames(), pane = element('estop-state');
    if (this.told && this.told.className === 'good' && !names.length) this.told = null;
    const { text = '', className = 'stands' } = this.told || {}, isGood = className === 'good';
    const lines = !this.told ? this.standing(names) : isGood ? `${this.standing(names)} All have acknowledged.` : text;
    pane.hidden = !this.told && !names.length;
    if (pane.className !== className) pane.className = className;
    if (element('estop-text').textContent !== lines) element('estop-text').textContent = lines;
    const [end, reset] = [element('estop-end'), element('estop-reset')];
    end.hidden = !this.told || isGood || (this.isStopping && (this.model.role !== 'operator' || !this.model.isConnected));
    end.textContent = this.isStopping ? 'Repeat it no longer' : 'Close';
    if (!this.told) element('estop-missing').replaceChildren();
    reset.hidden = !names.length || Boolean(this.isStopping);
    const all = this.model.robots.size;
    if (this.armed !== reset) reset.textContent = names.length === 1 ? `Reset ${names[0]}` : `Reset ${names.length === all ? `all ${all}` : names.length}`;
  }

  // Who stopped robots, why, which ones and since when.
  standing(names) {
    const groups = new Map(), { robots, plots, time } = this.model;
    for (const { name, row } of names.map((one) => robots.get(one))) {
      const why = plain(row.why || 'emergency stop').replace(/:? base lost .*/, '');
      if (!groups.has(why)) groups.set(why, []);
      groups.get(why).push(name);
    }
    const since = Math.min(...names.map((name) => robots.get(name).row.at).filter(Number.isFinite));
    const of = (some) => (some.length === robots.size && some.length > 1 ? `all ${some.length} robots` : some.length > MAX_NAMED ? `${some.length} of ${robots.size} robots` : some.join(', '));
    const told = [...groups].map(([why, some]) => `${why}: ${of(some)}`).join('; ');
    const passed = time - since;
    if (passed >= 0 && !(Math.abs(since - this.since) <= 2)) { // `at` has whole seconds: a clock that flickers would be read out
      this.since = since;
      this.clock = new Date(Date.now() - 1000 * ((this.isPast() ? plots.times.at(-1) : time) - since)).toLocaleTimeString([], { hour12: false });
    }
    const when = this.model.playback || !(passed >= 0) ? '' : `, since ${this.clock}${passed < 60 ? '' : ` (${ago(passed)})`}`;
    return `${told.charAt(0).toUpperCase()}${told.slice(1)}${when}.`;
  }
}
