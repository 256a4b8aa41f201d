// The legend: each colour and sign on the map, with its number of robots.

export class Legend {
  // `pick` selects the robots of an entry; without it entries are no buttons.
  constructor(box, map, pick) {
    Object.assign(this, { box, map, pick });
    this.shown = '';
  }

  draw() {
    const entries = this.map.legend();
    const shown = JSON.stringify(entries.map(({ robots, ...rest }) => [rest, robots && robots.length]));
    this.entries = entries; // a click selects the robots of now
    if (shown === this.shown) return;
    this.shown = shown;
    this.box.replaceChildren(...entries.map((entry, i) => this.item(entry, i)));
  }

  item({ colour, text, sign, shade, line, robots }, i) {
    const item = document.createElement(robots && this.pick ? 'button' : 'span'), mark = document.createElement('i');
    mark.style.setProperty('--mark', colour);
    mark.style.setProperty('--shade', `${100 * (shade ?? 1)}%`);
    if (line) mark.className = line;
    if (sign) mark.dataset.sign = sign;
    item.append(mark, text);
    if (robots) {
      const count = document.createElement('b');
      count.textContent = robots.length;
      item.append(count);
    }
    if (item.tagName === 'BUTTON') {
      item.type = 'button';
      item.title = `Select ${robots.length === 1 ? robots[0].name : `these ${robots.length} robots`}`;
      item.addEventListener('click', () => this.pick(this.entries[i].robots));
    }
    return item;
  }
}
