// Takeovers: another user took control of a drive from this session. Shown until dismissed.
import { effect, signal } from "./lib.js";
import { loadPreference, savePreference } from "./preferences.js";
import { connection } from "./live.js";
import { isMine, session } from "./session.js";
import { drive, idsOf, serviceNow } from "./store.js";

/** Takeovers kept; the oldest are dropped first. */
const MAX_TAKEOVERS = 20;
/** `{drive, owner, time_ms}`, the newest last; the time is null where the page had no connection meanwhile. */
export const takeovers = signal([]);
/** Drive → the session that held it when it was last seen. */
const holder = new Map();
/** Drives that this session held when the connection was lost: the time of a takeover is unknown. */
const whileAway = new Set();
/** Drives that this session released itself: another owner is no takeover. */
export const ownReleases = new Set();

const ownSession = () => session.value?.session ?? null;

function storeTakeovers(items) {
  takeovers.value = items.slice(-MAX_TAKEOVERS);
  savePreference("takeovers", { session: ownSession(), items: takeovers.value });
}

export const dismiss = (one) => storeTakeovers(takeovers.peek().filter((other) => other !== one));

function checkLeases(id, lease) {
  if (isMine(lease)) holder.set(id, ownSession());
  else {
    const wasMine = holder.get(id) === ownSession() && !ownReleases.has(id);
    if (wasMine && lease) storeTakeovers([...takeovers.peek(), {
      drive: id, owner: lease.owner, time_ms: whileAway.has(id) ? null : serviceNow(),
    }]);
    holder.delete(id);
    ownReleases.delete(id);
  }
  whileAway.delete(id);
}

/** Follow the drives. Takeovers that an earlier page of this session did not dismiss are shown again. */
export function watchTakeovers() {
  effect(() => {
    const kept = loadPreference("takeovers");
    takeovers.value = kept && kept.session === ownSession() ? kept.items : [];
  });
  effect(() => { if (connection.value === "lost") for (const id of holder.keys()) whileAway.add(id); });
  effect(() => { for (const id of idsOf("drives").value) checkLeases(id, drive(id).value?.lease ?? null); });
}
