// The patterns in groups, a line each, and a form of the parameters of the pattern that is chosen.

import { made } from './answers.js';

const element = (id) => document.getElementById(id);

const FIRST = ['gather', 'spread', 'move together'], LAST = ['yours', 'missions']; // groups: those that people look for, and the last ones
const RECENT = 'run last', MAX_RECENT = 4;
const FAR = 0.5; // edits for each letter from which on a name is not proposed

const wordsOf = (text) => text.toLowerCase().replace(/[_\s]+/g, ' ').trim();

export class PatternForm {
  constructor(model) {
    this.model = model;
    this.name = element('pattern'); // searches the list
    this.list = element('pattern-list');
    this.fields = element('params');
    this.named = new Set(); // patterns that the operator says robots have
    this.name.addEventListener('input', () => this.draw());
    this.name.addEventListener('keydown', (event) => {
      const rows = this.list.querySelectorAll('[data-name]');
      if (event.key === 'Enter' && rows.length === 1) this.choose(rows[0].dataset.name);
    });
    this.list.addEventListener('click', (event) => {
      const row = event.target.closest('[data-name]');
      if (row) this.choose(row.dataset.name);
    });
    for (const news of ['hello', 'selection']) model.addEventListener(news, () => this.draw());
    this.draw();
  }

  // The pattern that is typed or chosen, by its name or its shown text; undefined for other texts.
  get chosen() {
    const typed = wordsOf(this.name.value);
    return this.patterns().find((one) => wordsOf(one.name) === typed);
  }

  // The patterns of this computer, those that robots run, and those that the operator says robots have.
  patterns() {
    const { patterns, robots } = this.model, names = new Set(patterns.map((one) => one.name));
    const others = new Set([...robots.values()].map((one) => one.row.pattern).filter((name) => name && !names.has(name)));
    for (const name of this.named) if (!names.has(name)) others.add(name);
    return [...patterns, ...[...others].map((name) => ({ name, summary: 'On the robots, not on this computer.' }))];
  }

  // The parameters for `run`: only filled-in values, so that robots use their own defaults.
  params() {
    const free = this.fields.querySelector('[name="free"]');
    if (free) return free.value.trim();
    const filled = [...this.fields.querySelectorAll('[name]')].filter((one) => one.value !== '');
    return filled.map((one) => `${one.name}=${one.value}`).join(' ');
  }

  choose(name) {
    this.name.value = name.replaceAll('_', ' ');
    this.draw();
    const row = this.list.querySelector('[aria-selected="true"]');
    if (row) row.scrollIntoView({ block: 'nearest' });
  }

  // Robots have a pattern, also if this computer has it not.
  has(name) {
    this.named.add(name);
    this.choose(name);
  }

  // Store the name of a pattern that ran.
  ran(name) {
    try { localStorage.setItem('recent', JSON.stringify([name, ...this.recent().filter((one) => one !== name)].slice(0, MAX_RECENT))); } catch { /* not kept */ }
    this.draw();
  }

  recent() { try { return JSON.parse(localStorage.getItem('recent')) || []; } catch { return []; } }

  // Why target robots cannot run a pattern, and whether that holds for all of them.
  refusal({ unfit = {} }) {
    const some = [...this.platforms].filter((one) => unfit[one]);
    return { text: some.map((one) => `${one}: ${unfit[one]}`).join('; '), isAll: some.length > 0 && some.length === this.platforms.size };
  }

  draw() {
    const { robots, selected } = this.model;
    this.platforms = new Set([...robots.values()].filter(({ name }) => !selected.size || selected.has(name)).map((one) => one.platform));
    const typed = wordsOf(this.name.value), known = this.chosen, all = this.patterns();
    const matches = all.filter((one) => typed.split(' ').every((word) => wordsOf(`${one.name} ${one.group || ''} ${one.summary || ''}`).includes(word)));
    const shown = known ? all : matches, recent = typed && !known ? [] : this.recent();
    const { isAll } = known ? this.refusal(known) : {};
    element('run').disabled = element('param').disabled = !known || isAll;
    element('run').textContent = known ? `Run ${wordsOf(known.name)}` : 'Run ...';
    const key = JSON.stringify([known ? known.name : typed, recent, shown.map((one) => [one.name, one.group, one.summary, this.refusal(one)])]);
    if (key === this.drawn) return; // a hello must not take the focus
    this.drawn = key;
    const groupOf = (one) => one.group || 'yours', isGrey = (one) => Number(this.refusal(one).isAll);
    const rank = (group) => (FIRST.includes(group) ? FIRST.indexOf(group) : FIRST.length + 1 + LAST.indexOf(group));
    const order = (group) => `${Math.min(...shown.filter((one) => groupOf(one) === group).map(isGrey))}${rank(group)}${group}`;
    const groups = new Map([[RECENT, recent.map((name) => all.find((one) => one.name === name)).filter(Boolean)]]);
    for (const group of [...new Set(shown.map(groupOf))].sort((one, other) => (order(one) < order(other) ? -1 : 1))) {
      groups.set(group, shown.filter((one) => groupOf(one) === group).sort((one, other) => isGrey(one) - isGrey(other)));
    }
    const isGrouped = all.some((one) => one.group);
    this.list.replaceChildren(...[...groups].filter(([, some]) => some.length).map(([group, some]) => {
      const box = made('div', ''), head = isGrouped || group === RECENT ? [made('h3', group)] : [];
      box.role = 'group';
      box.ariaLabel = group;
      for (const one of head) one.ariaHidden = true; // the name of the group tells it
      box.append(...head, ...some.map((one) => this.rowOf(one, known)));
      return box;
    }));
    if (!shown.length) this.list.append(this.nothing(typed, all));
    this.drawFields(known);
  }

  rowOf(one, known) {
    const row = made('button', ''), { text, isAll } = this.refusal(one);
    row.type = 'button';
    row.dataset.name = one.name;
    row.setAttribute('role', 'option');
    row.setAttribute('aria-selected', one === known || Boolean(known) && one.name === known.name);
    if (isAll) row.setAttribute('aria-disabled', true);
    row.append(made('b', wordsOf(one.name)), made('span', one.summary || ''));
    if (text) row.append(made('small', `Not on ${text}`));
    return row;
  }

  // The text if no pattern matches: the nearest name, and that robots may have the pattern.
  nothing(typed, all) {
    const note = made('p', `No pattern here matches "${typed}".`), name = typed.replaceAll(' ', '_');
    const offer = (text, act) => {
      const button = made('button', text);
      button.type = 'button';
      button.addEventListener('click', act);
      note.append(button);
    };
    const [near] = all.map((one) => [edits(typed, wordsOf(one.name)), one.name]).sort(([one], [other]) => one - other);
    if (near && near[0] < FAR * typed.length) offer(`Did you mean ${wordsOf(near[1])}?`, () => this.choose(near[1]));
    offer(`Use "${typed}": only the robots have it`, () => this.has(name));
    return note;
  }

  drawFields(known) {
    const key = JSON.stringify(known || null);
    if (key === this.drawnFields) return;
    this.drawnFields = key;
    const note = element('params-note');
    note.textContent = known && known.params ? `Empty: the default of the robot, here that of a ${known.platform}.` : '';
    if (known && known.params) {
      // At first the parameters of this pattern alone, then those that its kind shares.
      const order = [...known.params].sort((one, other) => Number(other.is_own) - Number(one.is_own));
      this.fields.replaceChildren(...order.map(fieldOf));
    } else if (known) {
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

// The least number of letters to insert, remove or replace from one text to the other (Levenshtein).
function edits(from, to) {
  let row = Array.from({ length: to.length + 1 }, (_, i) => i);
  for (let i = 1; i <= from.length; i++) {
    const next = [i];
    for (let j = 1; j <= to.length; j++) next.push(Math.min(row[j] + 1, next[j - 1] + 1, row[j - 1] + (from[i - 1] !== to[j - 1])));
    row = next;
  }
  return row[to.length];
}
