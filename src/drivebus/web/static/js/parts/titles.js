// What a drive is called: a signal of its own, so that a list of names is not drawn anew with every value of a drive.
import { computed } from "../lib.js";
import { titleOf } from "../i18n.js";
import { drive } from "../store.js";

const titles = new Map();

/** The drive's title in the reader's language; the id of what is no drive of this plant. */
export function driveTitle(id) {
  if (!titles.has(id)) titles.set(id, computed(() => titleOf(drive(id).value ?? { id })));
  return titles.get(id).value;
}
