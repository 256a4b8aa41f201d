// The plots over time: a lane for each value, ticks for events, and the shown time.

import { Incidents } from './incidents.js';
import { incidentOf, plain } from './states.js';

const SPAN = 300; // s of a living swarm
const LEAST = 60; // s that are shown from the beginning on
const NOW = 1.5; // s before the last moment that count as now
// By key: the title, the unit, and what the lane shows at least (least and most).
const TITLES = { clusters: ['clusters', '', []], speed: ['mean speed', ' m/s', [0]], active: ['protection active', ' %', [0, 100]] };
const LANE = 40; // pixels of a lane
const NEAR = 7; // pixels between the mouse and the tick of events
const APART = 28; // pixels from a tick to the next one: nearer events have one tick
const MAX_TOLD = 4; // events of a tick that are told
const element = (id) => document.getElementById(id);

const titleOf = (key) => (TITLES[key] || [key.replace(/^\w+:/, '')])[0];
const factorOf = (key) => (key === 'active' ? 100 : 1);

const ago = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, '0')}`;

export class Plots {
  // `seek(time)` moves a recorded run, or looks back at a living swarm.
  constructor(model, seek) {
    Object.assign(this, { model, seek });
    this.canvas = element('plots');
    this.ctx = this.canvas.getContext('2d');
    this.back = element('back');
    this.key = element('plot');
    new ResizeObserver(() => this.wake()).observe(this.canvas);
    this.chips = new Incidents(element('incidents'), element('time-open'), this);
    for (const news of ['plots', 'past', 'hello', 'frame']) model.addEventListener(news, () => this.wake());
    this.canvas.addEventListener('pointerdown', (event) => { this.canvas.setPointerCapture(event.pointerId); this.isHeld = true; this.take(event); });
    this.canvas.addEventListener('pointermove', (event) => (this.isHeld ? this.take(event) : this.hover(event)));
    for (const end of ['pointerup', 'pointercancel']) this.canvas.addEventListener(end, () => { this.isHeld = false; });
    this.canvas.addEventListener('pointerleave', () => this.tell(null));
    this.back.addEventListener('input', () => this.to(this.latest() + Number(this.back.value)));
    element('past-now').addEventListener('click', () => model.lookAt(null));
    this.key.addEventListener('change', () => this.wake());
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    requestAnimationFrame(() => { this.isWaiting = false; this.chips.draw(); this.draw(); });
  }

  latest() { return this.model.plots.times.at(-1) || 0; }

  range() {
    const { playback } = this.model;
    if (playback) return [0, Math.max(playback.duration, 0.1)];
    const latest = this.latest(), first = this.model.plots.times[0] ?? latest;
    return [Math.max(latest - SPAN, Math.min(first, latest - LEAST)), latest];
  }

  to(time) {
    if (this.model.playback) this.seek(time);
    else this.model.lookAt(time > this.latest() - NOW ? null : time);
  }

  at(event) {
    const box = this.canvas.getBoundingClientRect(), [from, until] = this.range();
    const share = (event.clientX - box.left - this.left) / Math.max(box.width - this.left - this.right, 1);
    return from + Math.min(Math.max(share, 0), 1) * (until - from);
  }

  take(event) {
    this.to(this.at(event));
    this.hover(event);
  }

  // The values and events below the mouse.
  hover(event) {
    const box = this.canvas.getBoundingClientRect(), [from, until] = this.range(), time = this.at(event);
    const x = (at) => this.left + (at - from) / (until - from) * (box.width - this.left - this.right);
    const near = this.ticks(x, from, until).find(({ place }) => Math.abs(place - x(time)) < NEAR);
    this.tell(near ? near.marks : [], event.clientX - box.left, time);
  }

  tell(marks, x = 0, time = 0) {
    const note = element('mark-text');
    note.hidden = !marks;
    if (!marks) return;
    const values = this.lanes().map((key) => [key, this.valueAt(key, time)]).filter(([, value]) => value !== null);
    const told = values.map(([key, value]) => `${titleOf(key)} ${this.text(key, value)}`);
    const lines = marks.slice(-MAX_TOLD).map(([at, text, robots, count]) => `${this.clockOf(at)} ${count > robots.length ? `${count} robots` : robots.join(', ')}: ${plain(text)}`);
    if (marks.length > MAX_TOLD) lines.unshift(`${marks.length} events, of which the last:`);
    note.textContent = [`${this.clockOf(time)} ${told.join(', ')}`, ...lines].join('\n');
    note.style.left = `${Math.min(Math.max(x, 20), Math.max(this.canvas.clientWidth - 320, 20))}px`;
  }

  // The value of a lane at a time; null without a value.
  valueAt(key, time) {
    const { times, values } = this.model.plots;
    return (values[key] || [])[times.findLastIndex((one) => one <= time + 0.05)] ?? null;
  }

  text(key, value) {
    const unit = this.model.unitOf(key);
    return Number((factorOf(key) * value).toPrecision(2)) + (TITLES[key] ? TITLES[key][1] : unit && ` ${unit}`);
  }

  clockOf(time) {
    if (this.model.playback) return `${time.toFixed(1)} s`;
    return new Date(Date.now() - 1000 * (this.latest() - time)).toLocaleTimeString([], { hour12: false });
  }

  // The lanes: the values of all swarms, then chosen reports and readings.
  lanes() {
    const { values } = this.model.plots;
    const others = Object.keys(values).filter((key) => !TITLES[key]).sort();
    const wanted = ['', ...others];
    if ([...this.key.options].map((one) => one.value).join() !== wanted.join()) {
      const chosen = this.key.value;
      this.key.replaceChildren(...wanted.map((key) => new Option(key ? key.replace(/^\w+:/, '') : 'none', key)));
      if (wanted.includes(chosen)) this.key.value = chosen;
    }
    element('plot-choice').hidden = !others.length;
    const keys = Object.keys(TITLES).filter((key) => key !== 'clusters' || values.clusters);
    return this.key.value ? [...keys, this.key.value] : keys;
  }

  draw() {
    if (!this.canvas.clientWidth) return;
    const { canvas, ctx, model } = this, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const style = getComputedStyle(document.documentElement), rem = parseFloat(style.fontSize);
    const lanes = this.lanes(), axis = 1.1 * rem;
    canvas.style.height = `${Math.round(lanes.length * LANE + axis)}px`;
    const { clientWidth: w, clientHeight: h } = canvas, isNarrow = w < 600;
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
      [canvas.width, canvas.height] = [Math.round(w * ratio), Math.round(h * ratio)];
    }
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    ctx.clearRect(0, 0, w, h);
    const [text, dim, line, accent, danger] = ['--text', '--dim', '--line', '--accent', '--danger'].map((key) => style.getPropertyValue(key));
    [this.left, this.right] = [(isNarrow ? 9 : 14) * rem, 0.8 * rem];
    // The slider has the same axis.
    canvas.parentElement.style.setProperty('--axis-left', `${this.left}px`);
    canvas.parentElement.style.setProperty('--axis-right', `${this.right}px`);
    const [from, until] = this.range(), width = w - this.left - this.right;
    const x = (time) => this.left + (time - from) / (until - from) * width;
    this.drawAxis({ x, from, until, text, dim, line, rem, h, axis, isNarrow });
    lanes.forEach((key, i) => this.drawLane(key, i * LANE, { x, from, until, text, dim, accent, line, rem, isNarrow }));
    this.drawMarks(x, from, until, h - axis, rem, dim, danger);
    const shown = this.shown();
    ctx.strokeStyle = ctx.fillStyle = text;
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(x(shown), 0);
    ctx.lineTo(x(shown), h - axis);
    ctx.stroke();
    this.drawBack();
  }

  // Mark the time that the map shows.
  shown() {
    const { playback, past, time } = this.model;
    return playback ? time : past ?? this.latest();
  }

  drawAxis({ x, from, until, dim, line, rem, h, axis, isNarrow }) {
    const { ctx } = this, span = until - from, isLive = !this.model.playback;
    const most = Math.max(x(until) - this.left, 60) / ((isNarrow ? 3.4 : 4.5) * rem);
    const step = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200].find((one) => span / one <= most) || span;
    ctx.font = `${0.72 * rem}px system-ui, sans-serif`;
    ctx.fillStyle = dim;
    ctx.strokeStyle = line;
    ctx.lineWidth = 1;
    const first = isLive ? -Math.floor(span / step) * step : 0;
    for (let mark = first; mark <= (isLive ? 0 : until); mark += step) {
      const at = isLive ? until + mark : mark, place = x(at);
      ctx.beginPath();
      ctx.moveTo(place, 0);
      ctx.lineTo(place, h - axis);
      ctx.stroke();
      ctx.textAlign = at >= until ? 'right' : mark === first ? 'left' : 'center';
      ctx.fillText(this.words(mark, step), place, h - 0.25 * rem);
    }
  }

  // The label of a line of the axis: of a living swarm s before now, of a recorded run s since its start.
  words(mark, step) {
    if (this.model.playback) return step >= 60 ? ago(mark) : `${mark} s`;
    if (mark > -60) return mark ? `${mark} s` : 'now';
    return step % 60 ? `-${ago(-mark)}` : `${mark / 60} min`;
  }

  // The events grouped by tick; `place`: pixels of the first event.
  ticks(x, from, until) {
    const ticks = [];
    for (const mark of this.model.marks.filter(([at]) => at >= from && at <= until)) {
      const place = Math.round(x(mark[0])), last = ticks.at(-1);
      if (last && place - last.place < APART) last.marks.push(mark);
      else ticks.push({ place, marks: [mark] });
    }
    return ticks;
  }

  // An incident has the colour of a danger.
  drawMarks(x, from, until, bottom, rem, dim, danger) {
    const { ctx } = this;
    ctx.fillStyle = dim;
    ctx.strokeStyle = dim;
    ctx.globalAlpha = 0.55;
    ctx.lineWidth = 1;
    ctx.setLineDash([2, 3]);
    ctx.beginPath();
    const ticks = this.ticks(x, from, until);
    for (const { place } of ticks) { ctx.moveTo(place + 0.5, 0); ctx.lineTo(place + 0.5, bottom); }
    ctx.stroke();
    ctx.setLineDash([]);
    ctx.globalAlpha = 1;
    ctx.textAlign = 'left';
    ctx.font = `${0.72 * rem}px system-ui, sans-serif`;
    for (const { place, marks } of ticks) {
      if (marks.length > 1) {
        const words = `${marks.length} events`, isLast = place + 8 + ctx.measureText(words).width > x(until);
        ctx.fillStyle = dim;
        ctx.textAlign = isLast ? 'right' : 'left';
        this.label(words, place + (isLast ? -6 : 5), bottom - 1);
      }
      ctx.fillStyle = marks.some(([, text]) => incidentOf(text)) ? danger : dim;
      ctx.beginPath();
      ctx.moveTo(place - 4, bottom); ctx.lineTo(place + 4, bottom); ctx.lineTo(place, bottom - 6);
      ctx.fill();
    }
  }

  // The least and most value that a lane shows, in its unit.
  bounds(key, from, until) {
    const { times, values } = this.model.plots, factor = factorOf(key);
    const known = (values[key] || []).filter((one, i) => one !== null && one !== undefined && times[i] >= from && times[i] <= until).map((one) => factor * one);
    const all = [...known, ...(TITLES[key] ? TITLES[key][2] : [])];
    return all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
  }

  drawLane(key, top, { x, from, until, text, dim, accent, line, rem, isNarrow }) {
    const { ctx } = this, { times } = this.model.plots, values = this.model.plots.values[key] || [];
    const factor = factorOf(key);
    const now = this.valueAt(key, this.shown());
    const [least, most] = this.bounds(key, from, until), isFlat = most === least; // a flat line is in the middle
    const y = (value) => top + LANE - 4 - (isFlat ? 0.5 : (value * factor - least) / (most - least)) * (LANE - 9);
    ctx.strokeStyle = line;
    ctx.lineWidth = 1;
    ctx.beginPath();
    ctx.moveTo(0, top + LANE - 0.5); ctx.lineTo(x(until), top + LANE - 0.5);
    ctx.stroke();
    ctx.strokeStyle = accent;
    ctx.lineWidth = isNarrow ? 1.2 : 2;
    ctx.beginPath();
    let isOn = false;
    values.forEach((value, i) => {
      const isThere = value !== null && value !== undefined && times[i] >= from && times[i] <= until;
      if (isThere) ctx[isOn ? 'lineTo' : 'moveTo'](x(times[i]), y(value));
      isOn = isThere;
    });
    ctx.stroke();
    // Left of the lane: its title above its value, and at the axis the ends of the lane.
    const title = titleOf(key), small = `${0.68 * rem}px system-ui, sans-serif`, [upper, lower] = [top + 0.42 * LANE, top + 0.85 * LANE];
    ctx.textAlign = 'right';
    ctx.fillStyle = dim;
    ctx.font = small;
    ctx.fillText(isNarrow ? Number(most.toPrecision(2)) : this.text(key, most / factor), this.left - 0.4 * rem, top + 0.75 * rem);
    if (!isFlat) ctx.fillText(Number(least.toPrecision(2)), this.left - 0.4 * rem, top + LANE - 3);
    ctx.textAlign = 'left';
    if (!isNarrow) ctx.font = `${0.8 * rem}px system-ui, sans-serif`;
    ctx.fillText(isNarrow ? title.replace(/^mean | active$/, '') : title, 0.4 * rem, upper);
    ctx.fillStyle = text;
    ctx.font = `600 ${(isNarrow ? 0.75 : 0.85) * rem}px system-ui, sans-serif`;
    ctx.fillText(now === null ? '-' : this.text(key, now), 0.4 * rem, lower);
  }

  // A text that stays readable on lines.
  label(text, x, y) {
    const { ctx } = this;
    ctx.lineWidth = 4;
    ctx.lineJoin = 'round';
    ctx.strokeStyle = getComputedStyle(document.documentElement).getPropertyValue('--back');
    ctx.strokeText(text, x, y);
    ctx.fillText(text, x, y);
  }

  drawBack() {
    const { past, playback } = this.model, isPast = past !== null && !playback;
    const back = isPast ? this.latest() - past : 0;
    const [from, until] = this.range();
    this.back.min = Math.round(from - until);
    if (document.activeElement !== this.back || !isPast) this.back.value = -back;
    this.back.setAttribute('aria-valuetext', isPast ? `${ago(back)} ago` : 'now');
    element('past-note').hidden = !isPast;
    if (isPast) element('past-text').textContent = `The map shows the past: ${this.clockOf(past)}, ${ago(back)} ago.`;
  }
}
