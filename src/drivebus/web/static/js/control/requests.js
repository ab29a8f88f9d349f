// Requests for control: those of other users for drives of this session, and the answers to its own.
import { computed, signal } from "../lib.js";
import { api, drivePath } from "../api.js";
import { tickingServiceNow } from "../live.js";
import { releasing } from "./takeovers.js";
import { isMine } from "../session.js";
import { drive, idsOf } from "../store.js";

const requests = new Map();

/** Newest request for control of a drive, open or ended; null without one. Does not follow the drive's other values. */
function requestFor(id) {
  if (!requests.has(id)) requests.set(id, computed(() => drive(id).value?.control_request ?? null));
  return requests.get(id).value;
}

const newest = computed(() => idsOf("drives").value
  .map((id) => ({ id, request: requestFor(id) })).filter(({ request }) => request !== null));

/** Ids of requests whose answer this user has read. */
const readAnswers = signal(new Set());

/** Requests that were made together, have one state and were answered by the same user: `[{ids, request}]` of their drives. */
function grouped(items) {
  const groups = new Map();
  for (const { id, request } of items) {
    const key = answerKey(request);
    groups.set(key, { request, ids: [...(groups.get(key)?.ids ?? []), id] });
  }
  return [...groups.values()];
}

const answerKey = ({ id, state, answered_by }) => JSON.stringify([id, state, answered_by]);

/** Requests of other sessions for drives of this one. */
export const incomingRequests = () => grouped(newest.value.filter(({ id, request }) => request.state === "open"
  && isMine(drive(id).value?.lease)));

/** Answers to requests of this session that the user has not read. A request that was withdrawn needs none, nor does
 * control that was handed over and has ended since. */
export const unreadAnswers = () => grouped(newest.value.filter(({ id, request }) => isMine(request)
  && !["open", "withdrawn"].includes(request.state) && !readAnswers.value.has(answerKey(request))
  && (request.state !== "granted" || isMine(drive(id).value?.lease))));

export function markRead(request) {
  readAnswers.value = new Set(readAnswers.peek()).add(answerKey(request));
}

/** Open request for control of a drive, else null. */
export const openRequest = (view) => (view.control_request?.state === "open" ? view.control_request : null);

/** Seconds until an open request ends; counts down. */
export const secondsLeft = (request) => Math.max(0, Math.ceil((request.expires_ms - tickingServiceNow()) / 1000));

export const askForControl = (id, reason) => api.post(drivePath(id, "/control-request"), reason ? { reason } : {});

export const withdrawRequest = (id) => api.remove(drivePath(id, "/control-request"));

/** Withdraw the requests of this session for these drives. */
export const withdrawRequests = (drives) => api.post("/control-requests/withdraw", { drives });

const answer = (id, how, request) => api.post(drivePath(id, `/control-request/${how}`), { request: request.id });

export const declineRequests = (ids, request) => Promise.all(ids.map((id) => answer(id, "decline", request)));

/** Hand control of these drives over to the session that asks for it. */
export const grantRequests = (ids, request) => Promise.all(ids.map((id) => releasing(id,
  () => answer(id, "grant", request))));
