// Commands to robots, and the counted answer of each. The emergency stop never asks.

const MAX_ANSWERS = 8;
const CONFIRM = 5000; // ms in which the second click on Reset counts
let last = 0;

const made = (tag, text, className = '') => {
  const element = document.createElement(tag);
  element.textContent = text;
  element.className = className;
  return element;
};

export class Actions {
  constructor(model, send) {
    this.model = model;
    this.send = send; // False without a link
    this.box = document.getElementById('answers');
    this.waiting = new Map(); // entries without a final answer, by id
    const on = (id, act) => document.getElementById(id).addEventListener('click', act);
    on('estop', () => this.estop());
    on('stop', () => this.act('stop', { targets: this.chosen() }));
    on('reset', () => this.reset());
    on('param', () => this.act('param', { targets: this.named(), params: this.params() }));
    on('estop-end', () => (this.isStopping ? this.send({ kind: 'act', id: '', verb: 'end_estop' }) : this.hideEstop()));
    document.getElementById('run-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const pattern = document.getElementById('pattern').value.trim();
      if (pattern) this.act('run', { targets: this.named(), pattern, params: this.params() });
      else document.getElementById('pattern').focus();
    });
    document.getElementById('label-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const labels = document.getElementById('labels').value.trim();
      if (labels) this.act('label', { targets: this.named(), labels });
      else document.getElementById('labels').focus();
    });
    for (const news of ['selection', 'hello']) model.addEventListener(news, () => this.show());
    model.addEventListener('hello', () => this.returned());
    this.show();
  }

  chosen() { return this.model.selected.size ? [...this.model.selected] : null; }

  named() { return this.chosen() || [...this.model.robots.keys()]; }

  params() { return document.getElementById('params').value.trim(); }

  show() {
    const count = this.model.selected.size, all = this.model.robots.size;
    document.getElementById('targets').textContent = count
      ? `Commands go to ${count === 1 ? this.chosen()[0] : `the ${count} selected robots`}.`
      : `Commands go to all ${all} robots.`;
    const list = document.getElementById('patterns');
    if (list.children.length !== this.model.patterns.length) {
      list.replaceChildren(...this.model.patterns.map((name) => new Option(name)));
    }
    this.disarm();
  }

  // A second click confirms: a dialog would keep the emergency stop from being clicked.
  reset() {
    const button = document.getElementById('reset'), names = this.named();
    if (names.length > 1 && !this.isArmed) {
      this.isArmed = true;
      button.textContent = `Reset ${names.length}: may all move? Click again`;
      this.timer = setTimeout(() => this.disarm(), CONFIRM);
      return;
    }
    this.disarm();
    this.act('reset', { targets: names });
  }

  disarm() {
    clearTimeout(this.timer);
    this.isArmed = false;
    document.getElementById('reset').textContent = 'Reset';
  }

  act(verb, fields) {
    last += 1;
    const id = `${Date.now().toString(36)}-${last}`;
    // The frame that the operator saw: the server refuses to start motion long after it.
    const isSent = this.send({ kind: 'act', id, verb, seen: this.model.sequence, ...fields });
    if (!isSent) this.entry(id, `${verb}: not sent: no link to the server`, [], true);
    else if (verb !== 'estop') this.waiting.set(id, this.entry(id, `${verb} ...`, []));
    return isSent;
  }

  estop() {
    this.isUnsent = !this.send({ kind: 'act', id: `estop-${Date.now().toString(36)}`, verb: 'estop', targets: null });
    if (this.isUnsent) {
      this.showEstop('NOT SENT: no link to the server. It is sent when the link returns. Stop the robots by other means.', [], 'bad');
    } else this.estopped({ is_final: false, missing: [] });
  }

  connected() { if (this.isUnsent) this.estop(); }

  lost(hasEnded) {
    for (const [id, line] of this.waiting) {
      this.entry(id, `${line.querySelector('summary').textContent} the link was lost: not known what came of it`, [], true);
    }
    this.waiting.clear();
    if (this.isStopping) {
      const text = hasEnded ? 'The server ended and repeats it no longer' : 'The link was lost, and it is not known whether the server still repeats it';
      this.isCutOff = true;
      this.showEstop(`Emergency stop: ${text}. ${this.lacking()}`, this.missing, 'bad');
    }
  }

  lacking() { return this.missing.length ? 'Not acknowledged until then:' : 'Which robots have acknowledged it is not known.'; }

  // The first hello of a new link; if an emergency stop is under way, the server tells of it next.
  returned() {
    if (!this.isCutOff) return;
    this.isCutOff = this.isStopping = false;
    this.showEstop(`Emergency stop: the link was lost and is back, and the server repeats no emergency stop now. ${this.lacking()}`, this.missing, 'bad');
  }

  entry(id, text, replies, isBad = false) {
    let line = document.getElementById(`answer-${id}`);
    if (!line) {
      line = made('details', '', 'answer');
      line.id = `answer-${id}`;
      line.append(made('summary', ''), made('ul', ''));
      this.box.prepend(line);
      while (this.box.children.length > MAX_ANSWERS) this.box.lastChild.remove();
    }
    line.querySelector('summary').textContent = text;
    line.querySelector('ul').replaceChildren(...replies.map((one) => made('li', one)));
    line.classList.toggle('bad', isBad);
    line.classList.toggle('empty', !replies.length);
    return line;
  }

  answer(message) {
    if (message.id.startsWith('estop-') && !message.is_final) return; // shown above
    const order = ([, code]) => (code === 'applied' ? 1 : 0);
    const replies = [...message.replies].sort((one, other) => order(one) - order(other));
    const texts = replies.map(([name, code, text]) => `${name}: ${code}${text ? `: ${text}` : ''}`);
    const line = this.entry(message.id, message.line, [
      ...message.missing.map((name) => `${name}: no answer`), ...texts,
    ], message.is_final && !message.is_good);
    line.dataset.final = message.is_final;
    if (message.is_final) this.waiting.delete(message.id);
    line.open = message.is_final && !message.is_good && line.querySelectorAll('li').length < 20;
  }

  // The emergency stop under way, whichever page began it.
  estopped(message) {
    this.isCutOff = false;
    this.isStopping = !message.is_final;
    this.missing = message.missing;
    const lacks = message.missing.length;
    if (message.is_final) {
      const text = message.is_good ? `${message.line}: all have acknowledged.` : `${message.line}.`;
      this.showEstop(text, message.missing, message.is_good ? 'good' : 'bad');
    } else {
      const text = lacks ? `${lacks} not acknowledged; it is repeated until they do:` : 'sent; waits for acknowledgements ...';
      this.showEstop(`Emergency stop: ${text}`, message.missing, lacks ? 'bad' : '');
    }
  }

  showEstop(text, missing, className) {
    const pane = document.getElementById('estop-state');
    pane.hidden = false;
    pane.className = className;
    document.getElementById('estop-text').textContent = text;
    document.getElementById('estop-missing').replaceChildren(...missing.map((name) => {
      const item = made('li', ''), button = made('button', name);
      button.type = 'button';
      button.addEventListener('click', () => this.model.select([name]));
      item.append(button);
      return item;
    }));
    const end = document.getElementById('estop-end');
    end.hidden = this.isStopping && (this.model.role !== 'operator' || !this.model.isConnected);
    end.textContent = this.isStopping ? 'Repeat it no longer' : 'Close';
  }

  hideEstop() { document.getElementById('estop-state').hidden = true; this.isUnsent = false; }
}
