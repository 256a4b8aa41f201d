// The states of robots as a page shows them, and what it makes of texts that are for swarmctl.

// Each with a colour that people with colour blindness can tell apart (after Okabe and Ito 2008), a
// sign, and its order in counts. A robot at rest is shaded: see `SHADE`.
const STATES = {
  estopped: ['#b3001b', '\u2716'], faulted: ['#aa3f8f', '\u26a0'], held: ['#e07b00', '\u2016'],
  stopped: ['#f0d800', '\u25a0'], running: ['#009e73', '\u25b6'], 'at rest': ['#009e73', '\u25cc'],
  idle: ['#56b4e9', '\u25cb'],
};
const ORDER = Object.keys(STATES);
export const UNKNOWN = '#999999';
export const SHADE = 0.3; // the opacity of a robot at rest
export const LOST = '#ff00c8'; // a ring around a robot whose base is lost

export function colourOf(state) { return (STATES[state] || [UNKNOWN])[0]; }

export function signOf(state) { return (STATES[state] || ['', '\u2026'])[1]; }

export function byOrder(one, other) { return ORDER.indexOf(one) - ORDER.indexOf(other); }

// The state of a row in one word: a robot that runs may stand, at rest or held.
export function wordOf(row) { return row.stands || row.state || ''; }

// Why a robot stands, in a few words.
export function reasonOf(row) {
  return row.stands === 'at rest' ? `settled: ${row.pattern || 'its pattern'} requests no motion` : row.why || '';
}

// A text of swarmctl without its commands in backticks: the page has buttons.
export function plain(text) {
  return text.replace(/`swarmctl (\w)(\w*)[^`]*`/g, (_, first, rest) => `${first.toUpperCase()}${rest}`).replaceAll('`', '');
}
