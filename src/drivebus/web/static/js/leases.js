// Control of a drive: taken by hand, kept alive while this page is open, whichever page is shown.
import { api, drivePath } from "./api.js";
import { link, renew } from "./live.js";
import { isMine, may, session } from "./session.js";
import { drive, idsOf } from "./store.js";
import { giving } from "./takeovers.js";

/** A lease lives ten seconds. */
const RENEW_EVERY_MS = 3000;

export function take(id) {
  giving.delete(id);
  return api.post(drivePath(id, "/lease"));
}

export async function giveBack(id) {
  giving.add(id);
  try {
    return await api.remove(drivePath(id, "/lease"));
  } catch (error) {
    giving.delete(id);
    throw error;
  }
}

/** May the user command this drive now? */
export const inHand = (view) => isMine(view.lease) && may("operate");

const mine = () => idsOf("drives").peek().filter((id) => isMine(drive(id).peek()?.lease));

/** Drives that this session controls, by the newest that is known. */
export const held = () => idsOf("drives").value.filter((id) => isMine(drive(id).value?.lease));

function renewAll() {
  if (!session.peek()?.user) return;
  const drives = mine();
  if (drives.length === 0) return;
  // Without the live line the same is asked by REST; what comes of it is seen when the line is back.
  if (link.peek() === "live" && renew(drives)) return;
  for (const id of drives) api.post(drivePath(id, "/lease/renew"), {}, { patience_ms: 2500 }).catch(() => null);
}

export function keepLeases() {
  setInterval(renewAll, RENEW_EVERY_MS);
}
