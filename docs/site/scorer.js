/* How the search of the site orders its results: first the pages that people look for, then other
   pages, the reference, and the evidence. */
const FIRST = {
  'docs/operating': 5, 'docs/experiments': 5, 'docs/security': 4, 'docs/patterns': 3, 'docs/trouble': 3,
  'docs/installation': 2, 'docs/writing_experiments': 4, 'docs/goals': 3, 'docs/looking_after': 3, 'docs/permits': 3,
  'docs/ros_commands': 2, 'docs/last_word': 2,
};
const EVIDENCE =
  /^(docs\/(evidence|architecture)\/|docs\/(paper|ros_faults)$|benchmarks\/|studies\/|ARCHITECTURE$|CONTRIBUTING$|CHANGELOG$)/;

const placeOf = (page) => {
  if (EVIDENCE.test(page)) return -100;
  if (page.startsWith('docs/reference/')) return -12;
  return page.startsWith('docs/tutorial/') ? -3 : FIRST[page] ?? 0;
};

var Scorer = {
  score: ([page, title, anchor, description, score, file, kind]) =>
    score + placeOf(page) + (kind === 'title' ? 2 : 0),
  objNameMatch: 11,
  objPartialMatch: 6,
  objPrio: { 0: 15, 1: 5, 2: -5 },
  objPrioDefault: 0,
  title: 15,
  partialTitle: 7,
  term: 5,
  partialTerm: 2,
};
