// The answers to commands, counted: the last answer in a strip of fixed height, all in a drawer.

import { plain } from './states.js';

const MAX_ANSWERS = 8, MAX_NAMES = 12;
const NO_ANSWER = 'no answer';

export const made = (tag, text, className = '') => {
  const element = document.createElement(tag);
  element.textContent = text;
  element.className = className;
  return element;
};

export class Answers {
  // `propose(proposal)` carries out the proposal of a button (`proposalOf`).
  constructor(propose) {
    this.propose = propose;
    this.box = document.getElementById('answer-list');
    this.all = document.getElementById('answers-all');
    this.all.addEventListener('click', () => this.open(!this.isOpen));
    document.addEventListener('keydown', (event) => { if (event.key === 'Escape') this.open(false); });
    this.open(false);
  }

  open(isOpen) {
    this.isOpen = isOpen;
    this.box.parentElement.classList.toggle('open', isOpen);
    this.all.setAttribute('aria-expanded', isOpen);
    this.all.hidden = !this.box.children.length;
  }

  // `groups`: text and robots of each answer other than `applied`.
  show(id, text, groups = [], isBad = false, proposal = null) {
    let line = document.getElementById(`answer-${id}`);
    if (!line) {
      line = made('div', '', 'answer');
      line.id = `answer-${id}`;
      line.append(made('span', '', 'line'), made('ul', ''));
      line.firstChild.addEventListener('click', () => this.open(!this.isOpen));
      this.box.prepend(line);
      while (this.box.children.length > MAX_ANSWERS) this.box.lastChild.remove();
    }
    line.classList.toggle('bad', isBad);
    line.firstChild.textContent = isBad && groups.length === 1 ? `${text}: ${shortOf(...groups[0])}` : text;
    line.firstChild.title = line.firstChild.textContent;
    line.querySelector('ul').replaceChildren(...groups.map(([words, names]) => made('li', `${names.length} ${words} (${namesOf(names)})`)));
    for (const old of line.querySelectorAll('button')) old.remove();
    if (proposal) {
      const button = made('button', proposal.text, 'proposal');
      button.type = 'button';
      button.addEventListener('click', () => this.propose(proposal, button));
      line.firstChild.after(button);
    }
    this.open(this.isOpen);
    return line;
  }

  // An answer of the server; `fields` are those of the command.
  take(message, fields) {
    const groups = groupsOf(message);
    const isBad = message.is_final && !message.is_good;
    // The names are shown below: names of fifty robots would fill the line.
    const counts = plain(message.line).replace(/ \([^)]*\)/g, '');
    const text = isBad ? counts.replace(' 0 applied,', '').replace(/(\d+) targeted, (?=\1 [a-z ]+$)/, '') : counts;
    const line = this.show(message.id, text, groups, isBad, isBad ? proposalOf(message, fields) : null);
    line.dataset.final = message.is_final;
    return line;
  }
}

// The answers by text, each with its robots; successes without further text are left out.
function groupsOf({ replies, missing }) {
  const groups = new Map();
  const add = (text, name) => { if (!groups.has(text)) groups.set(text, []); groups.get(text).push(name); };
  for (const name of missing) add(NO_ANSWER, name);
  for (const [name, code, text] of replies) if (code !== 'applied' || text) add(text ? `${code}: ${plain(text)}` : code, name);
  return [...groups];
}

// The proposal in the texts of an answer: a reset of robots, or a pattern with a similar name.
function proposalOf({ line, replies }, fields) {
  const close = [line, ...replies.map(([, , text]) => text)].map((text) => /no pattern '[^']*'; did you mean '([^']+)'/.exec(text)).find(Boolean);
  if (close && fields && fields.verb === 'run') return { text: `Choose ${close[1]}`, pattern: close[1] };
  const names = replies.filter(([, , text]) => /reset it first|swarmctl reset/.test(text)).map(([name]) => name);
  return names.length ? { text: names.length === 1 ? `Reset ${names[0]}` : `Reset ${names.length}`, reset: names } : null;
}

// The only group of an answer, whose line has its code and number.
function shortOf(words, names) {
  const text = words.replace(/^\w+: /, '');
  return words === NO_ANSWER ? namesOf(names) : names.length === 1 ? `${text} (${names[0]})` : text;
}

function namesOf(names) {
  return names.length <= MAX_NAMES ? names.join(', ') : `${names.slice(0, MAX_NAMES - 1).join(', ')}, and ${names.length - MAX_NAMES + 1} more`;
}
