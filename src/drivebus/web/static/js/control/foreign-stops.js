// Stops that another user requested for drives of this session, until dismissed or until the drive is started again.
import { computed, effect, signal } from "../lib.js";
import { isMine, session } from "../session.js";
import { drive, idsOf } from "../store.js";

/** `[{drive, stop}]`, one of a drive. */
export const foreignStops = signal([]);
/** Stops by the service itself raise alarms, and the end of a jog or a test is its own user's. */
const USER_STOPS = ["drive", "group", "all"];
/** Drive → time of its last stop when it was last seen; 0: none. A stop of before the page was opened is none of its news. */
const seen = new Map();
const lastStops = new Map();

/** Last stop of a drive. Does not follow the drive's other values. */
function lastStop(id) {
  if (!lastStops.has(id)) lastStops.set(id, computed(() => drive(id).value?.last_stop ?? null));
  return lastStops.get(id).value;
}

export const dismissStops = (some) => {
  foreignStops.value = foreignStops.peek().filter((item) => !some.includes(item));
};

function checkStop(id, stop) {
  const [before, at] = [seen.get(id), stop?.time_ms ?? 0];
  seen.set(id, at);
  if (before === undefined || at === before) return;
  const isForeign = at > before && USER_STOPS.includes(stop.kind) && stop.actor !== session.peek().user
    && isMine(drive(id).peek()?.lease);
  const others = foreignStops.peek().filter((item) => item.drive !== id);
  if (isForeign || others.length < foreignStops.peek().length) {
    foreignStops.value = isForeign ? [...others, { drive: id, stop }] : others;
  }
}

/** Lists of stops for one sentence each: by one user, of one kind. */
export function groupedStops() {
  const groups = new Map();
  for (const item of foreignStops.value) {
    const alike = JSON.stringify([item.stop.actor, item.stop.kind]);
    groups.set(alike, [...(groups.get(alike) ?? []), item]);
  }
  return [...groups.values()];
}

export const watchForeignStops = () => effect(() => {
  for (const id of idsOf("drives").value) checkStop(id, lastStop(id));
});
