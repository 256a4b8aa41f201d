// Commands to robots, and the counted answer of each. The emergency stop never asks.

let last = 0;

export class Actions {
  constructor(model, send) {
    this.model = model;
    this.send = send;
    this.box = document.getElementById('answers');
    const on = (id, act) => document.getElementById(id).addEventListener('click', act);
    on('estop', () => this.act('estop', { targets: null }));
    on('stop', () => this.act('stop', { targets: this.chosen() }));
    on('reset', () => {
      const names = this.chosen() || [...this.model.robots.keys()];
      if (names.length < 2 || confirm(`Reset ${names.length} robots? Check that each of them may move again.`)) {
        this.act('reset', { targets: names });
      }
    });
    on('param', () => this.act('param', { targets: this.named(), params: this.params() }));
    document.getElementById('run-form').addEventListener('submit', (event) => {
      event.preventDefault();
      const pattern = document.getElementById('pattern').value.trim();
      const targets = this.named();
      if (pattern && targets.length) this.act('run', { targets, pattern, params: this.params() });
    });
    for (const news of ['selection', 'hello']) model.addEventListener(news, () => this.show());
    this.show();
  }

  chosen() { return this.model.selected.size ? [...this.model.selected] : null; }

  named() { return this.chosen() || [...this.model.robots.keys()]; }

  params() { return document.getElementById('params').value.trim(); }

  show() {
    const count = this.model.selected.size;
    const text = count ? `${count} selected` : `all ${this.model.robots.size}`;
    document.getElementById('targets').textContent = `Commands go to ${text}; the emergency stop to all.`;
    const list = document.getElementById('patterns');
    list.replaceChildren(...this.model.patterns.map((name) => new Option(name)));
  }

  act(verb, fields) {
    last += 1;
    const id = `${Date.now().toString(36)}-${last}`;
    this.send({ kind: 'act', id, verb, ...fields });
    this.entry(id, `${verb} ...`, '');
  }

  entry(id, text, who, isBad = false) {
    let line = document.getElementById(`answer-${id}`);
    if (!line) {
      line = document.createElement('p');
      line.className = 'answer';
      line.id = `answer-${id}`;
      const [what, names, close] = [document.createElement('span'), document.createElement('span'), document.createElement('button')];
      what.className = 'what';
      names.className = 'who';
      close.textContent = 'Close';
      close.type = 'button';
      close.addEventListener('click', () => line.remove());
      line.append(what, names, close);
      this.box.prepend(line);
      while (this.box.children.length > 8) this.box.lastChild.remove();
    }
    line.querySelector('.what').textContent = text;
    line.querySelector('.who').textContent = who;
    line.classList.toggle('bad', isBad);
    return line;
  }

  answer(message) {
    const bad = message.replies.filter(([, code]) => code !== 'applied').map(([name, code, text]) => `${name} ${code}: ${text}`);
    const missing = message.missing.length ? `no answer yet: ${message.missing.join(', ')}` : '';
    const line = this.entry(message.id, message.line, [missing, ...bad].filter(Boolean).join('; '), !message.is_good);
    line.dataset.final = message.is_final;
  }
}
