// The states of robots as a page shows them, and the page's form of texts for swarmctl.

// Each with a colour that people with colour blindness can tell apart (after Okabe and Ito 2008), a
// sign, and its order in counts, alarms first. A robot at rest is shaded: see `SHADE`.
const STATES = {
  silent: ['#ee1f45', '?'], estopped: ['#b3001b', '\u2716'], faulted: ['#aa3f8f', '\u26a0'], held: ['#e07b00', '\u2016'],
  stopped: ['#f0d800', '\u25a0'], running: ['#009e73', '\u25b6'], 'at rest': ['#009e73', '\u25cc'],
  driven: ['#cc79a7', '\u270b'], idle: ['#56b4e9', '\u25cb'], left: ['#7d8590', '\u2013'],
};
const ORDER = Object.keys(STATES);
const ALARMS = ['silent', 'estopped', 'faulted']; // the chips of which are filled
export const UNKNOWN = '#999999';
export const SHADE = 0.3; // the opacity of a robot at rest
export const LOST = '#ff00c8'; // a ring around a robot whose base is lost

export function colourOf(state) { return (STATES[state] || [UNKNOWN])[0]; }

export function signOf(state) { return (STATES[state] || ['', '\u2026'])[1]; }

export function isAlarm(state) { return ALARMS.includes(state); }

export function byOrder(one, other) { return ORDER.indexOf(one) - ORDER.indexOf(other); }

// The state of a row in a word; of a running robot that stands, `at rest` or `held`.
export function wordOf(row) { return row.stands || row.state || ''; }

// Why a robot stands and since when, in a few words; `time` on the clock of `row.at`.
export function reasonOf(row, time = NaN) {
  if (row.stands === 'at rest') return `settled: ${row.pattern || 'its pattern'} requests no motion`;
  if (row.driven_by) return `driven by ${row.driven_by}`;
  const passed = row.why && row.state !== 'running' ? time - row.at : NaN;
  return plain(row.why || '') + (passed >= 0 ? `, ${ago(passed)}` : '');
}

export function ago(seconds) {
  const [size, unit] = seconds < 60 ? [1, 's'] : seconds < 3600 ? [60, 'min'] : [3600, 'h'];
  return `${Math.floor(seconds / size)} ${unit} ago`;
}

// The incident that a line of a robot's log is of: its id, the robot that had it, its kind (`IncidentKind`; empty from
// a version that tells none or another one) and its text; null for another line.
const KINDS = 'estop|fault|hazard|driver_lost|loop_stalled|fence|assumption|silent|mark';
const INCIDENT = new RegExp(`^incident ([0-9a-f]{12}) of ([^\\s:]+): (?:(${KINDS}): )?(.*)$`, 's');
export function incidentOf(text) {
  const [, id, robot, kind = '', words] = text.match(INCIDENT) || [];
  return id ? { id, robot, kind, text: words } : null;
}

// A text of swarmctl or of a robot's log for people: the page has buttons instead of commands, and
// addresses, hosts of operators, codes in parentheses and measured speeds are in the details.
export function plain(text) {
  return text.replace(/`swarmctl (\w)(\w*)[^`]*`/g, (_, first, rest) => `${first.toUpperCase()}${rest}`).replaceAll('`', '')
    .replace(/,? by (\S+?)(?: from|, handed on by) \S+?(?=: |$)/g, ' by $1').replace(/\bby ([\w.-]+)@[\w.-]+/g, 'by $1')
    .replace(/: applied: .*$/, ': applied').replace(/ \((?:operator|estop|reset)\)/, '').replace(': from the page', ' from the page')
    .replace(/held by (\w+)/, (_, reason) => `held: ${reason.replaceAll('_', ' ')}`);
}
