// Title of a drive as a signal of its own, so that lists of names are not redrawn with every value.
import { computed } from "../lib.js";
import { titleOf } from "../i18n.js";
import { drive } from "../store.js";

const titles = new Map();

/** The drive's title in the reader's language; the id of what is no drive of this plant. */
export function driveTitle(id) {
  if (!titles.has(id)) titles.set(id, computed(() => titleOf(drive(id).value ?? { id })));
  return titles.get(id).value;
}
