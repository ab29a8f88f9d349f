// Title of each drive as its own signal, so that lists of names are not redrawn with every value.
import { computed } from "../lib.js";
import { titleOf } from "../i18n.js";
import { drive } from "../store.js";

const titles = new Map();

/** Title of a drive in the reader's language; its id where the plant has no such drive. */
export function driveTitle(id) {
  if (!titles.has(id)) titles.set(id, computed(() => titleOf(drive(id).value ?? { id })));
  return titles.get(id).value;
}
