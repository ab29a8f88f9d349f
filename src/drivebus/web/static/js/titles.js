// Titles of drives and groups, alone and as lists. That of a drive is a signal of its own: a list is not redrawn with every
// value of a drive.
import { computed } from "./lib.js";
import { isolated, t, titleOf } from "./i18n.js";
import { bus, drive, group } from "./store.js";

/** Order of names: motor 9 before motor 10. */
export const collator = new Intl.Collator(undefined, { numeric: true });

const titles = new Map();

/** Title of a drive in the reader's language; its id where the plant has no such drive. */
export function driveTitle(id) {
  if (!titles.has(id)) titles.set(id, computed(() => titleOf(drive(id).value ?? { id })));
  return titles.get(id).value;
}

/** Title of a bus in the reader's language; its id where the plant has no such bus. */
export const busTitle = (id) => titleOf(bus(id).value ?? { id });

/** Title of a group in the reader's language; its id where the plant has no such group. */
export const groupTitle = (id) => titleOf(group(id).value ?? { id });

/** Names of drives in one sentence; more are counted. */
const MAX_NAMES = 8;

/** Titles of drives as a list; of many the first ones and the number of the others. */
export const listDrives = (ids) => shortList(ids.map(driveTitle));

/** Items as a list; of many the first ones and the number of the others, where `sizes` has how many drives each item names. */
export function shortList(items, most = MAX_NAMES, sizes = items.map(() => 1)) {
  const names = items.slice(0, most).map(isolated).join(t("language.between_items"));
  const n = sizes.slice(most).reduce((sum, size) => sum + size, 0);
  return n > 0 ? t("page.names_more", { names, n }) : names;
}

/** Width of a letter in Latin letters. */
const widthOf = (letter) => (letter > "\u2E7F" ? 2 : 1);

/** A name of at most `most` letters; a longer one without its middle, because names of many drives differ at the end. A line
 * may break after the ellipsis. A Chinese character counts as two. */
export function shortened(name, most) {
  const letters = [...name];
  const total = letters.reduce((sum, letter) => sum + widthOf(letter), 0);
  if (total <= most) return name;
  const taken = (some) => {
    let left = (most - 1) / 2;
    return some.filter((letter) => { left -= widthOf(letter); return left >= 0; });
  };
  const [head, tail] = [taken(letters), taken([...letters].reverse()).reverse()];
  return `${head.join("").trimEnd()}…\u200B${tail.join("").trimStart()}`;
}
