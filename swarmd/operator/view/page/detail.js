// The details of a robot: why it stands, requested and safe command, and events.

import { colourOf, incidentOf, plain, reasonOf, signOf, wordOf } from './states.js';

const PERIOD = 200; // ms between two updates
const LIMIT = '#d55e00';

export class Detail {
  // `fetch(id)`: fetches an incident.
  constructor(model, fetch) {
    Object.assign(this, { model, fetch });
    this.dial = document.getElementById('dial');
    this.closed = new Set(['Robot', 'Health', 'Dropped', 'Peers']); // titles of folded sections
    for (const news of ['selection', 'rows', 'detail', 'hello']) model.addEventListener(news, () => this.wake());
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    setTimeout(() => { this.isWaiting = false; this.draw(); }, PERIOD);
  }

  draw() {
    const { selected, robots } = this.model;
    const name = [...selected].at(-1);
    const robot = robots.get(name);
    const set = (id, text) => { document.getElementById(id).textContent = text; };
    document.getElementById('detail-pane').classList.toggle('empty', !robot);
    if (!robot) {
      for (const id of ['detail-name', 'detail-why']) set(id, '');
      for (const id of ['detail-values', 'events']) document.getElementById(id).replaceChildren();
      this.dial.hidden = true;
      this.shown = null;
      return;
    }
    set('detail-name', selected.size > 1 ? `${name}, and ${selected.size - 1} more` : name);
    const { row } = robot, detail = robot.detail || {};
    const isHeard = this.model.isHeard(robot, performance.now());
    const reason = reasonOf(row, this.model.time), word = wordOf(row);
    const short = `${word || '?'}${reason ? `: ${reason}` : ''}${row.touches ? `; touches ${row.touches}` : ''}`;
    const age = this.model.age(robot, performance.now());
    // A robot that left or failed has this as its reason; swarmctl's sentence names a command that the page lacks.
    const isAlive = row.presence === 'alive', last = isAlive ? short : word;
    const passed = this.model.playback ? '' : Number.isFinite(age) ? ` for ${age.toFixed(0)} s` : ' at all';
    const old = `Not heard${passed}${isAlive ? '' : ` (${plain(row.why || row.presence)})`}${last ? `; last state: ${last}` : ''}`;
    const isLong = detail.why && word !== 'at rest' && this.model.past === null;
    set('detail-why', `${signOf(word)} ${!isHeard ? old : isLong ? plain(detail.why) : short}`);
    const needsReset = isHeard && ['estopped', 'faulted'].includes(row.state) && this.model.past === null;
    document.getElementById('detail-reset').hidden = !needsReset;
    if (this.shown !== detail) this.drawValues(detail);
    this.shown = detail;
    this.drawDial(robot);
  }

  drawValues(detail) {
    const sections = [...(detail.values ? [['', detail.values]] : []), ...(detail.sections || [])];
    document.getElementById('detail-values').replaceChildren(...sections.map(([title, rows]) => {
      const list = document.createElement('dl');
      for (const [key, value] of rows) {
        const [dt, dd] = [document.createElement('dt'), document.createElement('dd')];
        dt.textContent = key;
        dd.textContent = value;
        list.append(dt, dd);
      }
      if (!title) return list;
      const [fold, head] = [document.createElement('details'), document.createElement('summary')];
      head.textContent = title;
      fold.open = !this.closed.has(title);
      fold.addEventListener('toggle', () => (fold.open ? this.closed.delete(title) : this.closed.add(title)));
      fold.append(head, list);
      return fold;
    }));
    document.getElementById('events').replaceChildren(...(detail.events || []).map(([age, text]) => {
      const item = document.createElement('li'), incident = incidentOf(text);
      item.textContent = `${age}: ${plain(text)}`;
      if (incident) item.append(document.createElement('code'));
      if (incident) item.lastChild.textContent = `swarmctl incidents fetch ${incident.id}`;
      if (incident && this.mayFetch()) item.append(this.fetchOf(incident.id));
      return item;
    }));
  }

  // A recording has no robots to ask, and a page that may only look sends no command.
  mayFetch() { return this.model.role === 'operator' && !this.model.playback; }

  fetchOf(id) {
    const button = document.createElement('button');
    button.type = 'button';
    button.textContent = 'Fetch';
    button.title = 'Copies what robots keep of it to the computer of this page';
    button.addEventListener('click', () => this.fetch(id));
    return button;
  }

  // Forward is up. Wide and grey: the requested command. Narrow and coloured: the safe command. The outer arc: the turn.
  drawDial(robot) {
    const { requested, safe, limits } = robot.row;
    const rows = (robot.row.rows || []).filter((one) => one.every(Number.isFinite));
    this.dial.hidden = !requested || !limits || [...requested, ...safe].every((one) => one === 0);
    if (requested && limits) this.tell(requested, safe, rows);
    if (this.dial.hidden) return;
    const size = 220, ratio = Math.min(window.devicePixelRatio || 1, 2);
    if (this.dial.width !== size * ratio) this.dial.width = this.dial.height = size * ratio;
    const ctx = this.dial.getContext('2d'), middle = size / 2, reach = middle - 44;
    ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(document.documentElement);
    const [text, dim, line] = ['--text', '--dim', '--line'].map((key) => style.getPropertyValue(key));
    ctx.clearRect(0, 0, size, size);
    const arc = (radius, from, to, colour, width) => {
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.beginPath();
      ctx.arc(middle, middle, radius, from, to);
      ctx.stroke();
    };
    for (const share of [0.5, 1]) arc(share * reach, 0, 2 * Math.PI, line, 1);
    const draw = (twist, colour, width) => {
      const [ahead, aside] = [twist[0] / limits[0], twist[2] / (limits[2] || 1)];
      ctx.strokeStyle = colour;
      ctx.lineWidth = width;
      ctx.lineCap = 'round';
      ctx.beginPath();
      ctx.moveTo(middle, middle);
      ctx.lineTo(middle - reach * aside, middle - reach * ahead);
      ctx.stroke();
      ctx.lineCap = 'butt';
      const turn = Math.max(-1, Math.min(1, twist[1] / limits[1])) * Math.PI * 0.75;
      arc(reach + 9, -Math.PI / 2 - Math.max(turn, 0), -Math.PI / 2 - Math.min(turn, 0), colour, width);
    };
    draw(requested, dim, 10);
    draw(safe, colourOf(wordOf(robot.row)), 5);
    ctx.font = '13px system-ui, sans-serif';
    ctx.textAlign = 'center';
    for (const [bearing, gap] of rows.slice(0, 3)) {
      const angle = -Math.PI / 2 - bearing;
      arc(reach + 18, angle - 0.22, angle + 0.22, LIMIT, 5);
      const [x, y] = [middle + (reach + 34) * Math.cos(angle), middle + (reach + 32) * Math.sin(angle)];
      ctx.fillStyle = text;
      ctx.fillText(`${gap.toFixed(2)} m`, Math.min(Math.max(x, 22), size - 22), Math.min(Math.max(y + 4, 11), size - 4));
    }
  }

  tell(requested, safe, rows) {
    const words = (twist) => `${twist[0].toFixed(2)} m/s, ${twist[1].toFixed(2)} rad/s`;
    const limit = rows.length
      ? `Limited to ${rows[0][2].toFixed(2)} m/s towards an obstacle ${rows[0][1].toFixed(2)} m away, ${Math.abs(Math.round(rows[0][0] * 57.3))} degrees to the ${rows[0][0] > 0 ? 'left' : 'right'}.`
      : 'No obstacle limits it.';
    const text = `Requested ${words(requested)}. Safe ${words(safe)}. ${limit}`;
    document.getElementById('dial-text').textContent = text;
    this.dial.setAttribute('aria-label', text);
  }
}
