// Told until it is read: who took a drive from this very session. Whose a drive is now, its own page says.
import { effect, signal } from "./lib.js";
import { recall, remember } from "./memory.js";
import { link } from "./live.js";
import { isMine, session } from "./session.js";
import { drive, idsOf, plantNow } from "./store.js";

/** Nobody reads more; the oldest go first. */
const MOST = 20;
/** `{drive, owner, time_ms}`, the newest last; the time is null where the page had no connection meanwhile. */
export const takeovers = signal([]);
/** Drive → the session that held it when it was last seen. */
const holder = new Map();
/** Drives whose line was lost since, and those that are being given back: who has one next took it from nobody. */
const unseen = new Set();
export const giving = new Set();

const me = () => session.value?.session ?? null;

function keep(items) {
  takeovers.value = items.slice(-MOST);
  remember("takeovers", { session: me(), items: takeovers.value });
}

export const read = (one) => keep(takeovers.peek().filter((other) => other !== one));

function look(id, lease) {
  if (isMine(lease)) holder.set(id, me());
  else {
    const wasMine = holder.get(id) === me() && !giving.has(id);
    if (wasMine && lease) keep([...takeovers.peek(), {
      drive: id, owner: lease.owner, time_ms: unseen.has(id) ? null : plantNow(),
    }]);
    holder.delete(id);
    giving.delete(id);
  }
  unseen.delete(id);
}

/** Follows the drives from now on. What an earlier page of the same session left unread is told again. */
export function watchTakeovers() {
  effect(() => {
    const kept = recall("takeovers");
    takeovers.value = kept && kept.session === me() ? kept.items : [];
  });
  effect(() => { if (link.value === "lost") for (const id of holder.keys()) unseen.add(id); });
  effect(() => { for (const id of idsOf("drives").value) look(id, drive(id).value?.lease ?? null); });
}
