// Ends of control that this tab did not make: another session took a drive, another tab of this session released it, or
// the lease ended because it was not renewed. Shown until dismissed.
import { effect, signal } from "../lib.js";
import { loadPreference, savePreference } from "../preferences.js";
import { connection } from "../live.js";
import { isInOtherWindow, isMine, session } from "../session.js";
import { drive, idsOf, serviceNow } from "../store.js";

/** Takeovers kept; the oldest are dropped first. */
const MAX_TAKEOVERS = 500;
/** `{drive, owner, cause, time_ms}`, the newest last: `cause` is "taken" (by `owner`), "window" (by this
 * user in another one), "tab" or "ended"; the time is null where the page had no connection meanwhile. */
export const takeovers = signal([]);
/** Drive → the session that held it when it was last seen. */
const holder = new Map();
/** Drives that this session held when the connection was lost: the time of a takeover is unknown. */
const whileAway = new Set();
/** Drives that this session released itself: another owner is no takeover. */
export const ownReleases = new Set();

/** Drives that another tab of this browser releases. */
const otherTabReleases = new Set();
/** Releases are announced to the other tabs, which share session and control: `{session, drive, isReleased}`. */
const tabs = new BroadcastChannel("drivebus.control");

const ownSession = () => session.value?.session ?? null;

function storeTakeovers(items) {
  takeovers.value = items.slice(-MAX_TAKEOVERS);
  savePreference("takeovers", { session: ownSession(), items: takeovers.value });
}

export const dismiss = (some) => storeTakeovers(takeovers.peek().filter((takeover) => !some.includes(takeover)));

/** Lists of takeovers for one sentence each: by the same user, for the same cause. */
export function groupTakeovers(items) {
  const groups = new Map();
  for (const takeover of items) {
    const alike = JSON.stringify([takeover.owner, takeover.cause, takeover.time_ms === null]);
    groups.set(alike, [...(groups.get(alike) ?? []), takeover]);
  }
  return [...groups.values()];
}

function announceRelease(id, isReleased) {
  if (isReleased) ownReleases.add(id);
  else ownReleases.delete(id);
  tabs.postMessage({ session: ownSession(), drive: id, isReleased });
}

/** Send a request that ends control of a drive; this tab and the others know that it is no takeover. */
export async function releasing(id, send) {
  announceRelease(id, true);
  try {
    return await send();
  } catch (error) {
    announceRelease(id, false);
    throw error;
  }
}

function onOtherTab({ data: { session: of, drive: id, isReleased } }) {
  if (of !== ownSession()) return;
  if (isReleased) otherTabReleases.add(id);
  else otherTabReleases.delete(id);
}

function causeOf(id, lease) {
  if (otherTabReleases.has(id)) return "tab";
  if (isInOtherWindow(lease)) return "window";
  return lease ? "taken" : "ended";
}

function checkLeases(id, lease) {
  if (isMine(lease)) holder.set(id, ownSession());
  else {
    const wasMine = holder.get(id) === ownSession() && !ownReleases.has(id);
    if (wasMine) storeTakeovers([...takeovers.peek(), {
      drive: id, owner: lease?.owner ?? null, cause: causeOf(id, lease), time_ms: whileAway.has(id) ? null : serviceNow(),
    }]);
    holder.delete(id);
    ownReleases.delete(id);
    otherTabReleases.delete(id);
  }
  whileAway.delete(id);
}

/** Follow the drives and the other tabs. Takeovers that an earlier page of this session did not dismiss are shown again. */
export function watchTakeovers() {
  tabs.onmessage = onOtherTab;
  effect(() => {
    const kept = loadPreference("takeovers");
    takeovers.value = kept && kept.session === ownSession() ? kept.items : [];
  });
  effect(() => { if (connection.value === "lost") for (const id of holder.keys()) whileAway.add(id); });
  effect(() => { for (const id of idsOf("drives").value) checkLeases(id, drive(id).value?.lease ?? null); });
}
