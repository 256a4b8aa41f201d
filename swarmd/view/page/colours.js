// Colours that people with colour blindness can tell apart (Okabe and Ito 2008), each with a sign.

const PALETTE = ['#0072b2', '#e69f00', '#009e73', '#cc79a7', '#56b4e9', '#d55e00', '#f0e442', '#999999'];
const STATES = {
  running: ['#009e73', '\u25b6'], idle: ['#56b4e9', '\u25cb'], stopped: ['#e69f00', '\u25a0'],
  estopped: ['#d55e00', '\u2716'], faulted: ['#cc79a7', '\u26a0'],
};
const UNKNOWN = ['#999999', '?'];
const STEPS = 64;
const MAX_WORDS = 40; // texts with a colour of their own; a robot may report another one each second

export function stateColour(state) { return STATES[state] || UNKNOWN; }

// The colour of each robot by one value: of words by palette, of numbers along one scale.
export class Colouring {
  // `low` and `high`: the least range of the scale, such as that of the field that robots measure.
  constructor(key, low = Infinity, high = -Infinity) {
    Object.assign(this, { key, low, high });
    this.words = new Map();
  }

  value(robot) {
    if (this.key === 'state') return robot.row.state;
    if (this.key === 'labels') return (robot.row.labels || []).join(', ');
    if (this.key === 'platform') return robot.platform;
    const [kind, name] = this.key.split(/:(.*)/); // pattern, or report:opinion
    return name === undefined ? robot.row[kind] : (robot.row[kind] || {})[name];
  }

  of(robot) {
    const value = this.value(robot);
    if (this.key === 'state') return stateColour(value)[0];
    if (value === undefined || value === null || value === '') return UNKNOWN[0];
    if (typeof value === 'number') {
      this.low = Math.min(this.low, value);
      this.high = Math.max(this.high, value);
      return scale((value - this.low) / Math.max(this.high - this.low, 1e-9));
    }
    const word = String(value);
    if (!this.words.has(word) && this.words.size >= MAX_WORDS) return UNKNOWN[0];
    if (!this.words.has(word)) this.words.set(word, PALETTE[this.words.size % PALETTE.length]);
    return this.words.get(word);
  }

  legend(robots) {
    for (const robot of robots) this.of(robot);
    if (this.key === 'state') {
      const seen = new Set([...robots].map((one) => one.row.state).filter(Boolean));
      return [...seen].map((state) => [stateColour(state)[0], `${stateColour(state)[1]} ${state}`]);
    }
    const found = [...this.words].map(([word, colour]) => [colour, word]);
    if (found.length === MAX_WORDS) found.push([UNKNOWN[0], 'others']);
    if (this.high >= this.low) {
      found.push([scale(0), this.low.toPrecision(3)], [scale(1), this.high.toPrecision(3)]);
    }
    return found;
  }
}

// Dark blue to yellow, even in lightness.
export function scale(share) {
  const t = Math.round(Math.min(Math.max(share, 0), 1) * STEPS) / STEPS;
  return `hsl(${230 - 180 * t} ${60 + 20 * t}% ${32 + 32 * t}%)`;
}
