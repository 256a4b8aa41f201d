// The patterns, a line each, and a form of the parameters of the one that is chosen.

import { made } from './answers.js';

const element = (id) => document.getElementById(id);

export class PatternForm {
  constructor(model) {
    this.model = model;
    this.name = element('pattern'); // searches the list; a name that is not listed may be on the robots
    this.list = element('pattern-list');
    this.fields = element('params');
    this.name.addEventListener('input', () => this.draw());
    this.list.addEventListener('click', (event) => {
      const row = event.target.closest('[data-name]');
      if (row) this.choose(row.dataset.name);
    });
    model.addEventListener('hello', () => this.draw());
  }

  get pattern() { return this.name.value.trim(); }

  // As `run` takes them: only what was filled in, so that robots keep their own defaults.
  params() {
    const free = this.fields.querySelector('[name="free"]');
    if (free) return free.value.trim();
    const filled = [...this.fields.querySelectorAll('[name]')].filter((one) => one.value !== '');
    return filled.map((one) => `${one.name}=${one.value}`).join(' ');
  }

  choose(name) {
    this.name.value = name;
    this.draw();
    const row = this.list.querySelector('[aria-selected="true"]');
    if (row) row.scrollIntoView({ block: 'nearest' });
  }

  draw() {
    const typed = this.pattern, { patterns } = this.model;
    const matches = patterns.filter((one) => `${one.name} ${one.summary || ''}`.toLowerCase().includes(typed.toLowerCase()));
    const known = patterns.find((one) => one.name === typed);
    const shown = known || !matches.length ? patterns : matches;
    const key = JSON.stringify([typed, shown.length, patterns.map((one) => Boolean(one.summary))]);
    if (key === this.drawn) return; // a hello must not take the focus
    this.drawn = key;
    this.list.replaceChildren(...shown.map((one) => {
      const row = made('button', '');
      row.type = 'button';
      row.dataset.name = one.name;
      row.setAttribute('role', 'option');
      row.setAttribute('aria-selected', one.name === typed);
      row.append(made('b', one.name.replaceAll('_', ' ')), made('span', one.summary || ''));
      return row;
    }));
    element('run').textContent = typed ? `Run ${typed.replaceAll('_', ' ')}` : 'Run ...';
    this.drawFields(known);
  }

  drawFields(known) {
    const key = JSON.stringify(known || Boolean(this.pattern));
    if (key === this.drawnFields) return;
    this.drawnFields = key;
    const note = element('params-note');
    note.textContent = known && known.params ? `Empty: the default of the robot, here that of a ${known.platform}.` : '';
    if (known && known.params) {
      // What this pattern has first, then what patterns of its kind share.
      const order = [...known.params].sort((one, other) => Number(other.is_own) - Number(one.is_own));
      this.fields.replaceChildren(...order.map(fieldOf));
    } else if (this.pattern) {
      const label = made('label', 'Parameters'), input = made('input', '');
      Object.assign(input, { name: 'free', placeholder: 'speed=0.1 turn=0', autocomplete: 'off', spellcheck: false });
      label.append(input);
      this.fields.replaceChildren(label);
    } else this.fields.replaceChildren();
  }
}

// A parameter: its name, an input with its bounds, its unit and its meaning.
function fieldOf(spec) {
  const label = made('label', ''), value = made('span', '', 'value');
  const input = inputOf(spec);
  input.name = spec.name;
  input.required = spec.is_required;
  value.append(input, made('span', spec.unit, 'unit'));
  label.append(made('span', spec.name, 'name'), value, made('small', [spec.description, boundsOf(spec)].filter(Boolean).join('; ')));
  return label;
}

function inputOf(spec) {
  const choices = spec.type === 'bool' ? ['true', 'false'] : spec.choices;
  if (choices.length) {
    const select = document.createElement('select');
    select.append(new Option(spec.is_required ? 'choose ...' : String(spec.default), ''), ...choices.filter((one) => one !== String(spec.default)).map((one) => new Option(one, one)));
    return select;
  }
  const input = made('input', '');
  input.placeholder = spec.is_required ? 'required' : shortOf(spec.default);
  if (spec.type === 'float' || spec.type === 'int') {
    Object.assign(input, { type: 'number', inputMode: 'decimal', step: spec.type === 'int' ? '1' : 'any' });
    if (spec.ge !== null) input.min = spec.ge;
    if (spec.le !== null) input.max = spec.le;
  } else input.pattern = '\\S*';
  return input;
}

function boundsOf({ ge, le, unit }) {
  const after = unit ? ` ${unit}` : '';
  if (ge !== null && le !== null) return `${ge} to ${le}${after}`;
  if (ge !== null) return `at least ${ge}${after}`;
  return le !== null ? `at most ${le}${after}` : '';
}

function shortOf(value) { return typeof value === 'number' ? String(Number(value.toPrecision(4))) : value === null ? 'none' : String(value); }
