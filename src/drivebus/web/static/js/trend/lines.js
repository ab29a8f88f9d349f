// Lines of a chart: their units, which of these have an axis, and which lines are hidden at first. Pure.
//
// A status or fault word, a list of terminals and a count have no unit: they are drawn as steps, each on its own scale
// without an axis, and have no mean.

/** Number of line colours; more lines share them. */
export const HUES = 8;
/** Axes of one chart: more can't be distinguished. */
const MAX_AXES = 2;

/** Whether a line shows a word: a value without a unit. */
export const isWord = (line) => !line.unit;

const unitsOf = (lines) => [...new Set(lines.filter((line) => !isWord(line)).map((line) => line.unit))];

/** Units of the lines that are shown, those of the newest tags of `recent` first. */
export function shownUnits(lines, hidden, recent) {
  const rank = (line) => (recent.includes(line.tag) ? recent.indexOf(line.tag) : recent.length);
  const shown = lines.filter((line) => !hidden.has(line.tag));
  return unitsOf([...shown].sort((one, other) => rank(one) - rank(other)));
}

/** Units that have an axis. */
export const axisUnits = (lines, hidden, recent) => shownUnits(lines, hidden, recent).slice(0, MAX_AXES);

/** Lines that a chart of many signals shows at first: those of its first units that are no words, all where every one is. */
export function firstLines(lines) {
  const units = unitsOf(lines).slice(0, MAX_AXES);
  return units.length === 0 ? lines : lines.filter((line) => units.includes(line.unit));
}

/** Whether all known values of a series are whole numbers, as those of a word are. */
export const isWhole = ({ min, max }) => min.every(isWholeOrUnknown) && max.every(isWholeOrUnknown);

const isWholeOrUnknown = (value) => value == null || Number.isInteger(value);

/** Values of a word within a window, in their order, a repeated one once; null for a stretch of several values. */
export function valuesOfWord({ t, min, max }, { from, to }) {
  const found = [];
  t.forEach((at, n) => {
    if (at < from || at > to || max[n] == null) return;
    const value = min[n] === max[n] ? max[n] : null;
    if (found.length === 0 || found.at(-1) !== value) found.push(value);
  });
  return found;
}
