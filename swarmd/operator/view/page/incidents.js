// The incidents of a swarm as chips: when, which robot, and of which kind. A click shows that instant.

import { made } from './answers.js';
import { incidentOf, plain } from './states.js';

const MAX_CHIPS = 20; // the last ones
const BEFORE = 1; // s before an incident that a click shows

export class Incidents {
  // `box`: of the chips. `opener`: the button of the panel with the box, which tells their number. `plots`: the time axis.
  constructor(box, opener, plots) {
    Object.assign(this, { box, opener, plots, shown: '', title: opener.textContent });
  }

  // Each incident once, by its id: the earliest mark, since other robots hear of it later.
  all() {
    const found = new Map();
    for (const [at, text] of this.plots.model.marks) {
      const one = incidentOf(text);
      if (one && (!found.has(one.id) || found.get(one.id).at > at)) found.set(one.id, { ...one, at });
    }
    return [...found.values()].sort((one, other) => one.at - other.at).slice(-MAX_CHIPS);
  }

  draw() {
    const all = this.all();
    const key = JSON.stringify(all.map(({ id, at, kind, text }) => [id, at, kind, text]));
    if (key === this.shown) return;
    this.shown = key;
    this.box.hidden = !all.length;
    this.box.replaceChildren(...all.map((one) => this.chip(one)));
    this.box.scrollLeft = this.box.scrollWidth; // the last one
    this.opener.textContent = all.length ? `${this.title} (${all.length})` : this.title;
    this.opener.classList.toggle('alarm', all.length > 0);
    this.opener.title = all.length ? `Plots, the past, and ${all.length === 1 ? 'an incident' : `${all.length} incidents`} (p)` : 'Plots, events and the past (p)';
  }

  chip({ id, robot, kind, at, text }) {
    const chip = made('button', '');
    chip.type = 'button';
    chip.dataset.incident = id;
    chip.title = `${plain(text)} (incident ${id}): show that instant`;
    chip.append(made('time', this.plots.clockOf(at)), made('b', robot), made('span', kind.replaceAll('_', ' ') || plain(text)));
    chip.addEventListener('click', () => this.plots.to(Math.max(at - BEFORE, this.plots.range()[0])));
    return chip;
  }
}
