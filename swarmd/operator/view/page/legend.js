// The legend, and the chips of the states: colours and signs with their numbers of robots.

export class Legend {
  // `found()` gives the entries. `pick` selects the robots of an entry; without it entries are no buttons.
  constructor(box, found, pick) {
    Object.assign(this, { box, found, pick });
    this.shown = '';
  }

  draw() {
    const entries = this.found();
    const shown = JSON.stringify(entries.map(({ robots, ...rest }) => [rest, robots && robots.length]));
    this.entries = entries; // a click selects the robots of now
    if (shown === this.shown) return;
    this.shown = shown;
    this.box.replaceChildren(...entries.map((entry, i) => this.item(entry, i)));
    this.fit();
  }

  // Without room for the words of all entries, those of the last ones, which are calm, are left out.
  fit() {
    const { box } = this, items = [...box.children];
    for (const item of items) item.classList.remove('short');
    while (items.length && (box.scrollWidth > box.clientWidth || box.scrollHeight > box.clientHeight)) items.pop().classList.add('short');
  }

  item({ colour, text, sign, shade, line, look, names, robots }, i) {
    const item = document.createElement(robots && this.pick ? 'button' : 'span'), mark = document.createElement('i');
    item.style.setProperty('--mark', colour);
    if (look) item.className = look;
    mark.style.setProperty('--shade', `${100 * (shade ?? 1)}%`);
    if (line) mark.className = line;
    if (sign) mark.dataset.sign = sign;
    const word = document.createElement('span');
    word.textContent = text;
    item.append(mark, word);
    item.ariaLabel = robots ? `${text}: ${robots.length}` : text; // also where the word is left out
    if (robots) {
      const count = document.createElement('b');
      count.textContent = names ? `${robots.length}: ${names}` : robots.length;
      item.append(count);
    }
    if (item.tagName === 'BUTTON') {
      item.type = 'button';
      item.title = `${names || text}: select ${robots.length === 1 ? robots[0].name : `these ${robots.length} robots`}`;
      item.addEventListener('click', () => this.pick(this.entries[i].robots));
    }
    return item;
  }
}
