// Control leases: taken by the user, renewed while a tab of this session is open.
import { api, drivePath } from "../api.js";
import { isLive, renewLeases } from "../live.js";
import { isMine, may, session } from "../session.js";
import { idsOf, newest } from "../store.js";
import { ownReleases, releasing } from "./takeovers.js";

/** A lease expires after ten seconds without a renewal. */
const RENEW_EVERY_MS = 3000;

export function takeControl(id) {
  ownReleases.delete(id);
  return api.post(drivePath(id, "/lease"));
}

export const releaseControl = (id) => releasing(id, () => api.remove(drivePath(id, "/lease")));

/** Whether the user may command this drive now. */
export const hasControl = (view) => isMine(view.lease) && may("operate");

/** Drives under control of this session, by the newest message: a slow screen shows it later. */
export const ownDrives = () => idsOf("drives").peek().filter((id) => isMine(newest(`drives/${id}`)?.lease));

function renewAll() {
  if (!session.peek()?.user) return;
  const drives = ownDrives();
  if (drives.length === 0) return;
  // Without a live connection the leases are renewed by REST; the result shows after the reconnect.
  if (isLive.peek() && renewLeases(drives)) return;
  for (const id of drives) api.post(drivePath(id, "/lease/renew"), {}, { timeout_ms: 2500 }).catch(() => null);
}

export function startLeaseRenewal() {
  setInterval(renewAll, RENEW_EVERY_MS);
}
