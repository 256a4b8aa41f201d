// The colour of robots by their state or by any value, and its legend.

import { SHADE, UNKNOWN, byOrder, colourOf, signOf, wordOf } from './states.js';

const PALETTE = ['#0072b2', '#e69f00', '#009e73', '#cc79a7', '#56b4e9', '#d55e00', '#f0e442', '#7f5539'];
const STEPS = 64;
const MAX_WORDS = 40; // texts with a colour of their own; a robot may report another one each second

// The colour of each robot by a value: words from a palette, numbers on a scale.
export class Colouring {
  // `low` and `high`: the range that the scale has at least, such as that of a measured field.
  constructor(key, low = Infinity, high = -Infinity) {
    Object.assign(this, { key, low, high });
    this.words = new Map();
  }

  value(robot) {
    if (this.key === 'state') return wordOf(robot.row);
    if (this.key === 'labels') return (robot.row.labels || []).join(', ');
    if (this.key === 'platform') return robot.platform;
    const [kind, name] = this.key.split(/:(.*)/); // pattern, or report:opinion
    return name === undefined ? robot.row[kind] : (robot.row[kind] || {})[name];
  }

  of(robot) {
    const value = this.value(robot);
    if (this.key === 'state') return colourOf(value);
    if (isNone(value)) return UNKNOWN;
    if (typeof value === 'number') {
      this.low = Math.min(this.low, value);
      this.high = Math.max(this.high, value);
      return scale((value - this.low) / Math.max(this.high - this.low, 1e-9));
    }
    const word = String(value);
    if (!this.words.has(word) && this.words.size >= MAX_WORDS) return UNKNOWN;
    if (!this.words.has(word)) this.words.set(word, PALETTE[this.words.size % PALETTE.length]);
    return this.words.get(word);
  }

  // The entries of the legend: colour, text and, for few words, the robots. `unit`: of numbers.
  legend(robots, unit) {
    const groups = new Map(), none = [];
    for (const robot of robots) {
      const value = this.value(robot), colour = this.of(robot);
      if (isNone(value)) none.push(robot);
      else if (typeof value !== 'number') {
        const text = colour === UNKNOWN && this.key !== 'state' ? 'others' : String(value);
        if (!groups.has(text)) groups.set(text, { colour, text, robots: [] });
        groups.get(text).robots.push(robot);
      }
    }
    const isState = this.key === 'state';
    const found = isState
      ? [...groups.values()].sort((one, other) => byOrder(one.text, other.text))
        .map((one) => ({ ...one, sign: signOf(one.text), shade: one.text === 'at rest' ? SHADE : 1 }))
      : [...groups.values()];
    if (this.high >= this.low) {
      const [low, high] = [this.low, this.high].map((one) => `${one.toPrecision(3)} ${unit}`.trim());
      found.push({ colour: scale(0), text: low }, { colour: scale(1), text: high });
    }
    if (none.length) found.push({ colour: UNKNOWN, text: `no ${this.key.replace(/^\w+:/, '')}`, robots: none });
    return found;
  }
}

function isNone(value) { return value === undefined || value === null || value === ''; }

// From dark blue to yellow, with even steps of lightness.
export function scale(share) {
  const t = Math.round(Math.min(Math.max(share, 0), 1) * STEPS) / STEPS;
  return `hsl(${230 - 180 * t} ${60 + 20 * t}% ${32 + 32 * t}%)`;
}
