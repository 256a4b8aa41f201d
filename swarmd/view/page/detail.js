// One robot in detail: why it stands, what it asked for, what protection made of it, and its events.

import { stateColour } from './colours.js';

export class Detail {
  constructor(model) {
    this.model = model;
    this.dial = document.getElementById('dial');
    for (const news of ['selection', 'rows', 'detail', 'hello']) model.addEventListener(news, () => this.wake());
  }

  wake() {
    if (this.isWaiting) return;
    this.isWaiting = true;
    setTimeout(() => { this.isWaiting = false; this.draw(); }, 100);
  }

  draw() {
    const { selected, robots } = this.model;
    const name = [...selected].at(-1);
    const robot = robots.get(name);
    const title = document.getElementById('detail-name');
    const why = document.getElementById('detail-why');
    const values = document.getElementById('detail-values');
    const events = document.getElementById('events');
    if (!robot) {
      title.textContent = 'No robot selected';
      why.textContent = 'Select one on the map or in the list.';
      values.replaceChildren();
      events.replaceChildren();
      this.dial.hidden = true;
      return;
    }
    title.textContent = selected.size > 1 ? `${name}, and ${selected.size - 1} more` : name;
    const [, sign] = stateColour(robot.row.state);
    why.textContent = `${sign} ${robot.row.state || '?'}${robot.row.why ? `: ${robot.row.why}` : ''}${robot.row.touches ? `; touches ${robot.row.touches}` : ''}`;
    const detail = robot.detail || {};
    values.replaceChildren(...(detail.values || []).flatMap(([key, value]) => {
      const [dt, dd] = [document.createElement('dt'), document.createElement('dd')];
      dt.textContent = key;
      dd.textContent = value;
      return [dt, dd];
    }));
    events.replaceChildren(...(detail.events || []).map(([age, text]) => {
      const item = document.createElement('li');
      item.textContent = `${age}: ${text}`;
      return item;
    }));
    this.drawDial(robot);
  }

  // Ahead is up. Grey: requested, coloured: safe; the arc is the turn. A bar: the obstacle that limits.
  drawDial(robot) {
    const { requested, safe, limits, rows } = robot.row;
    this.dial.hidden = !requested;
    if (!requested) return;
    const ctx = this.dial.getContext('2d'), middle = this.dial.width / 2, reach = middle - 34;
    const style = getComputedStyle(document.documentElement);
    const [text, dim, line] = ['--text', '--dim', '--line'].map((key) => style.getPropertyValue(key));
    ctx.clearRect(0, 0, this.dial.width, this.dial.height);
    ctx.strokeStyle = line;
    ctx.lineWidth = 1;
    for (const share of [0.5, 1]) {
      ctx.beginPath();
      ctx.arc(middle, middle, share * reach, 0, 2 * Math.PI);
      ctx.stroke();
    }
    const draw = (twist, colour, width) => {
      ctx.strokeStyle = ctx.fillStyle = colour;
      ctx.lineWidth = width;
      ctx.beginPath();
      ctx.moveTo(middle, middle);
      ctx.lineTo(middle - reach * (twist[2] / (limits[2] || 1)), middle - reach * (twist[0] / limits[0]));
      ctx.stroke();
      const turn = Math.max(-1, Math.min(1, twist[1] / limits[1])) * Math.PI * 0.75;
      ctx.beginPath();
      ctx.arc(middle, middle, reach + 6 + width / 2, -Math.PI / 2 - Math.max(turn, 0), -Math.PI / 2 - Math.min(turn, 0));
      ctx.stroke();
    };
    draw(requested, dim, 9);
    draw(safe, stateColour(robot.row.state)[0], 4);
    ctx.fillStyle = text;
    ctx.strokeStyle = '#d55e00';
    ctx.lineWidth = 5;
    for (const [bearing, gap, cap] of (rows || []).slice(0, 3)) {
      const angle = -Math.PI / 2 - bearing;
      ctx.beginPath();
      ctx.arc(middle, middle, reach + 16, angle - 0.22, angle + 0.22);
      ctx.stroke();
      ctx.font = '11px system-ui, sans-serif';
      ctx.textAlign = 'center';
      const [x, y] = [middle + (reach + 27) * Math.cos(angle), middle + (reach + 27) * Math.sin(angle)];
      ctx.fillText(`${gap.toFixed(2)} m`, Math.min(Math.max(x, 20), 200), y + 4);
      if (rows[0][0] === bearing) this.dial.title = `limited to ${cap.toFixed(2)} m/s towards an obstacle ${gap.toFixed(2)} m away`;
    }
    const words = (twist) => `${twist[0].toFixed(2)} m/s, ${twist[1].toFixed(2)} rad/s`;
    this.dial.setAttribute('aria-label', `requested ${words(requested)}; safe ${words(safe)}`
      + ((rows || []).length ? `; limited by an obstacle ${rows[0][1].toFixed(2)} m away, ${Math.round(rows[0][0] * 57.3)} degrees to the left` : ''));
  }
}
