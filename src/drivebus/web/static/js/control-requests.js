// Requests for control: those of other users for drives of this session, and the answers to its own.
import { computed, signal } from "./lib.js";
import { api, drivePath } from "./api.js";
import { releasing } from "./control-taken.js";
import { isMine } from "./session.js";
import { drive, idsOf, serviceNow } from "./store.js";

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

/** Drives of this session that another session asks for: `[{id, request}]`. */
export const incomingRequests = () => newest.value.filter(({ id, request }) => request.state === "open"
  && isMine(drive(id).value?.lease));

/** Answers to requests of this session that the user has not read. A request that was withdrawn needs none. */
export const unreadAnswers = () => newest.value.filter(({ request }) => isMine(request)
  && !["open", "withdrawn"].includes(request.state) && !readAnswers.value.has(request.id));

export function markRead(request) {
  readAnswers.value = new Set(readAnswers.peek()).add(request.id);
}

/** Seconds until an open request ends. */
export const secondsLeft = (request) => Math.max(0, Math.ceil((request.expires_ms - serviceNow()) / 1000));

export const askForControl = (id, reason) => api.post(drivePath(id, "/control-request"), reason ? { reason } : {});

export const withdrawRequest = (id) => api.remove(drivePath(id, "/control-request"));

export const declineRequest = (id, request) => api.post(drivePath(id, "/control-request/decline"), { request: request.id });

/** Hand control over to the session that asks for it. */
export const grantRequest = (id, request) => releasing(id,
  () => api.post(drivePath(id, "/control-request/grant"), { request: request.id }));
