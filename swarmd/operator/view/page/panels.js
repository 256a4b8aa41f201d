// The panels beside or over the map: table, commands, display options, time; and the map alone.

const element = (id) => document.getElementById(id);
const kept = (key, value) => { try { if (value !== undefined) localStorage.setItem(key, value); return localStorage.getItem(key); } catch { return null; } };
const PHONE = '(max-width: 900px)';
export const isOnPhone = () => matchMedia(PHONE).matches;

// A button that shows and hides a panel; only one panel over the map is open at a time.
const PANELS = [['robots-open', 'list-pane'], ['run-open', 'commands'], ['look-open', 'look'], ['time-open', 'time']];
const OVER = ['commands', 'look'];

export class Panels {
  constructor(map) {
    this.map = map;
    for (const [opener, panel] of PANELS) {
      element(opener).setAttribute('aria-controls', panel);
      element(opener).addEventListener('click', () => { if (element(opener).getAttribute('aria-disabled') !== 'true') this.open(panel, element(panel).hidden); });
    }
    for (const one of document.querySelectorAll('.close')) {
      one.addEventListener('click', () => this.open(one.closest('[data-panel]').id, false));
    }
    this.open('time', (kept('time') ?? String(!isOnPhone())) === 'true');
    for (const [name, usual] of [['dark', matchMedia('(prefers-color-scheme: dark)').matches], ['large', false]]) this.check(name, usual);
  }

  open(panel, isOpen) {
    const isPhone = isOnPhone();
    if (isOpen) for (const other of OVER) if (other !== panel && (OVER.includes(panel) || isPhone)) this.set(other, false);
    if (isOpen && isPhone && panel !== 'list-pane') this.set('list-pane', false);
    this.set(panel, isOpen);
    if (panel === 'time') kept('time', isOpen);
    if (isOpen && panel === 'commands' && !isPhone) element('pattern').focus();
  }

  set(panel, isOpen) {
    element(panel).hidden = !isOpen;
    const [opener] = PANELS.find(([, one]) => one === panel);
    element(opener).setAttribute('aria-pressed', isOpen);
    document.body.classList.toggle(`with-${panel}`, isOpen);
  }

  // Close the panel over the map on Escape; false if none was open.
  closed() {
    const open = OVER.filter((one) => !element(one).hidden);
    for (const one of open) this.set(one, false);
    return open.length > 0;
  }

  // Show only the map and its legend, for a projector.
  present(isOn = !document.body.classList.contains('present')) {
    document.body.classList.toggle('present', isOn);
    element('present').setAttribute('aria-pressed', isOn);
    this.map.nameSize = isOn ? 1.3 : 0.78; // readable from the last row
    this.closed();
  }

  check(name, usual) {
    const box = element(name);
    box.checked = (kept(name) ?? String(usual)) === 'true';
    const paint = () => { document.documentElement.classList.toggle(name, box.checked); this.map.resize(); this.map.wake(); this.map.model.tell('plots'); };
    box.addEventListener('change', () => { kept(name, box.checked); paint(); });
    paint();
  }
}
