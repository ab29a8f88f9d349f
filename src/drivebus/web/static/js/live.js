// One WebSocket for the whole page: a snapshot, then deltas into the store. Lost: everything shown is stale at once,
// and the page comes back by itself.
import { computed, signal } from "./lib.js";
import { loadSession, loggedIn, session } from "./session.js";
import { recall } from "./memory.js";
import { delta, noticeSleep, nowMs, snapshot } from "./store.js";

const ALWAYS = ["plant", "drives/*", "groups/*", "buses/*", "alarms"];
/** The server says something at least every second; twice that in silence and nothing shown counts as live. */
const SILENCE_MS = 2000;
/** So long for the connection and its snapshot. */
const FIRST_WORD_MS = 6000;
const FIRST_WAIT_MS = 400;
const LONGEST_WAIT_MS = 5000;
const INTERVAL_S = recall("interval_s", 0.25);

/** "starting", "live", or "lost". */
export const link = signal("starting");
/** Are the values of the store live? Where not, every surface shows them as stale and only stops are offered. */
export const trusted = computed(() => link.value === "live");
/** When something was last heard over a link that is lost now (`nowMs`), else null. */
export const lostAt = signal(null);
/** What the server said when it closed: a text in both languages, else null. */
export const closedText = signal(null);
/** Ticks twice a second: ages on the page follow it. */
export const now = signal(nowMs());

const wanted = new Map();
let socket = null;
let heardAt = 0;
let openedAt = 0;
let wait_ms = FIRST_WAIT_MS;
let timer = null;

const patterns = () => [...new Set([...ALWAYS, ...wanted.keys()])];

function say(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** Adds a topic pattern for a page (frames/line-1, events); the function it gives takes it back. */
export function subscribe(pattern) {
  wanted.set(pattern, (wanted.get(pattern) ?? 0) + 1);
  say({ subscribe: patterns() });
  return () => {
    const users = wanted.get(pattern) - 1;
    if (users > 0) wanted.set(pattern, users);
    else wanted.delete(pattern);
    say({ subscribe: patterns() });
  };
}

/** Keeps leases alive; false where the line is lost. */
export function renew(drives) {
  say({ renew: drives });
  return socket?.readyState === WebSocket.OPEN;
}

function address() {
  const query = new URLSearchParams({ topics: patterns().join(","), interval: String(INTERVAL_S) });
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/live?${query}`;
}

function heard(event) {
  heardAt = nowMs();
  const message = JSON.parse(event.data);
  if (message.type === "closed") closedText.value = message.text ?? null;
  if (message.type === "delta") delta(message);
  if (message.type !== "snapshot") return;
  snapshot(message);
  live();
}

function live() {
  wait_ms = FIRST_WAIT_MS;
  link.value = "live";
  lostAt.value = null;
  closedText.value = null;
}

function lost() {
  if (link.peek() !== "lost") lostAt.value = heardAt || nowMs();
  link.value = "lost";
}

/** Gives the socket up and says so; another one comes after a while. */
function drop() {
  const old = socket;
  socket = null;
  if (old) {
    old.onmessage = null;
    old.onclose = null;
    old.close();
  }
  lost();
  later();
}

function later() {
  clearTimeout(timer);
  if (!loggedIn.peek()) return;
  timer = setTimeout(open, wait_ms * (0.75 + Math.random() / 2));
  wait_ms = Math.min(wait_ms * 2, LONGEST_WAIT_MS);
}

/** Does the server answer at all? If not, it is tried again later. */
async function meets() {
  const found = await loadSession().then(() => true, () => false);
  if (!found) later();
  return found;
}

async function open() {
  clearTimeout(timer);
  // The session may be over, or the server may be another one: a socket alone does not tell why it is refused.
  if (link.peek() === "lost" && !(await meets())) return;
  if (!loggedIn.peek() || socket) return;
  openedAt = nowMs();
  socket = new WebSocket(address());
  socket.onmessage = heard;
  socket.onclose = drop;
}

/** Tries at once, as the user or the system's network asks for. */
export function reconnect() {
  wait_ms = FIRST_WAIT_MS;
  if (link.peek() !== "live" && !socket) open();
}

function tick() {
  noticeSleep();
  now.value = nowMs();
  const quiet_ms = nowMs() - (link.peek() === "live" ? heardAt : openedAt);
  if (socket && quiet_ms > (link.peek() === "live" ? SILENCE_MS : FIRST_WORD_MS)) drop();
}

/** Follows the session from now on: connected while somebody is logged in. */
export function start() {
  setInterval(tick, 500);
  addEventListener("online", reconnect);
  document.addEventListener("visibilitychange", () => { if (!document.hidden) reconnect(); });
  session.subscribe(() => {
    if (loggedIn.peek() && !socket && link.peek() === "starting") open();
    if (!loggedIn.peek()) hangUp();
  });
}

function hangUp() {
  clearTimeout(timer);
  if (socket) {
    socket.onclose = null;
    socket.close();
  }
  socket = null;
  heardAt = 0;
  link.value = "starting";
}
