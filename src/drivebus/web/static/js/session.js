// Session and rights of the user. The server checks every right again; here they only shape the page.
import { computed, signal } from "./lib.js";
import { api, session } from "./api.js";
import { nowMs } from "./store.js";

export { session };

export const loggedIn = computed(() => Boolean(session.value?.user));

/** Whether the user has a right of the server's table: `may("operate")`. */
export const may = (right) => (session.value?.rights ?? []).includes(right);

/** Whether a lease, or a request for control, is of this session. */
export const isMine = (lease) => lease !== null && lease !== undefined && lease.session === session.value?.session;

/** Whether a lease is of another session of this user: another browser, a private window or another computer. The owner of
 * a lease that is not remote is a user of the machine, who may have the same name. */
export const isInOtherWindow = (lease) => Boolean(lease?.remote) && !isMine(lease) && lease.owner === session.value?.user;

/**
 * Load the session, again where it has changed meanwhile: unlocking replaces the cookie, and an answer to the old cookie
 * is out of date. Raises ApiError when the server cannot be reached.
 */
export async function loadSession() {
  const before = session.peek();
  const found = await api.get("/session");
  if (session.peek() !== before) return loadSession();
  session.value = found;
}

export async function login(name, password) {
  await api.post("/login", { name, password });
  await loadSession();
}

export async function loginOnce(code) {
  await api.post("/login/code", { code });
  await loadSession();
}

export async function setUp(secret, name, password) {
  await api.post("/setup", { secret, name, password });
  await loadSession();
}

/** Whether the session has ended without a log-out on this page: it expired, or was ended elsewhere. */
export const hasEnded = signal(false);
/** Why it has, in both languages; null where that is not known. */
export const endText = signal(null);
let isLoggingOut = false;
let hadUser = false;

session.subscribe((found) => {
  const hasUser = Boolean(found?.user);
  if (hasUser || hadUser || found?.ended) hasEnded.value = !hasUser && !isLoggingOut;
  if (hasUser) endText.value = null;
  else if (found?.ended) endText.value = found.ended;
  else if (hadUser && !isLoggingOut) loadSession().catch(() => null); // a denied request has not said why
  hadUser = hasUser;
});

/** Log-out that the server has not confirmed, {session, error}: the session may still be open. */
export const failedLogout = signal(null);

export async function logout() {
  const id = session.peek().session;
  failedLogout.value = null;
  isLoggingOut = true;
  try {
    await api.post("/logout");
    session.value = { ...session.peek(), user: null, rights: [] };
  } catch (error) {
    if (error.status !== 401) failedLogout.value = { session: id, error };
  }
  isLoggingOut = false;
  await loadSession().catch(() => null);
}

/** True while the server has suspended the rights to control after inactivity; the right to stop stays. */
export const idle = computed(() => Boolean(session.value?.idle));

/** Enter the password again: the same session, with its leases, regains all its rights. */
export async function unlock(password) {
  session.value = await api.post("/session/unlock", { password });
  return true;
}

const ACTIVITY_INTERVAL_MS = 60_000;
let activitySentAt = 0;

/** Report activity to the server at most once a minute. It does not unlock an idle session. */
async function onActivity() {
  if (!loggedIn.peek() || idle.peek() || nowMs() - activitySentAt < ACTIVITY_INTERVAL_MS) return;
  activitySentAt = nowMs();
  const before = session.peek();
  const found = await api.post("/session/activity").catch(() => null);
  if (found && session.peek() === before) session.value = found;
}

/** Report the user's activity, and reload the rights every minute. */
export function watchActivity() {
  for (const event of ["pointerdown", "keydown"]) addEventListener(event, onActivity, { passive: true, capture: true });
  setInterval(() => { if (loggedIn.peek()) loadSession().catch(() => null); }, ACTIVITY_INTERVAL_MS);
}
