// One WebSocket for the whole page: a snapshot, then deltas into the store. When it is lost every value is stale at
// once, and the page reconnects by itself.
import { computed, signal } from "./lib.js";
import { endText, loadSession, loggedIn, session } from "./session.js";
import { applyDelta, applySnapshot, noticeSleep, nowMs, serviceNow } from "./store.js";

const DEFAULT_TOPICS = ["plant", "drives/*", "groups/*", "buses/*", "alarms"];
/** The server sends at least every 1.7 s; soon after that no value counts as live. */
const MESSAGE_TIMEOUT_MS = 2000;
/** Limit for the connection and its snapshot. Each attempt that reaches it doubles it, because a busy server needs longer
 * where many pages ask again. */
const SNAPSHOT_TIMEOUT_MS = 6000;
const MAX_SNAPSHOT_TIMEOUT_MS = 30_000;
const MIN_RECONNECT_DELAY_MS = 400;
const MAX_RECONNECT_DELAY_MS = 5000;
const INTERVAL_S = 0.25;
/** Close code of the server. */
const SESSION_ENDED_CODE = 4401;

/** "starting", "live", or "lost". */
export const connection = signal("starting");
/** Whether the values of the store are live. Where not, they are shown as stale and only stops are offered. */
export const isLive = computed(() => connection.value === "live");
/** Time of the last message of a lost connection (`nowMs`), else null. */
export const lostAt = signal(null);
/** Reason that the server gave for closing, in both languages, else null. */
export const closedText = signal(null);
/** Ticks twice a second: ages on the page follow it. */
export const now = signal(nowMs());

/** The plant's time; what shows it is drawn again at every tick. */
export function tickingServiceNow() {
  now.value;
  return serviceNow();
}

const subscriptions = new Map();
let socket = null;
let lastMessageAt = 0;
let openedAt = 0;
let snapshotTimeout_ms = SNAPSHOT_TIMEOUT_MS;
let reconnectDelay_ms = MIN_RECONNECT_DELAY_MS;
let reconnectTimer = null;

const patterns = () => [...new Set([...DEFAULT_TOPICS, ...subscriptions.keys()])];

function send(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** Subscribe to a topic pattern (frames/bus-1, events); returns the function that unsubscribes. */
export function subscribe(pattern) {
  subscriptions.set(pattern, (subscriptions.get(pattern) ?? 0) + 1);
  send({ subscribe: patterns() });
  return () => {
    const users = subscriptions.get(pattern) - 1;
    if (users > 0) subscriptions.set(pattern, users);
    else subscriptions.delete(pattern);
    send({ subscribe: patterns() });
  };
}

/** The server closes the connection for a message with more. */
const MAX_RENEWALS = 200;

/** Messages that renew the control leases of these drives, each within the server's limit. */
export function renewMessages(drives) {
  const count = Math.ceil(drives.length / MAX_RENEWALS);
  return Array.from({ length: count }, (_, n) => ({ renew: drives.slice(n * MAX_RENEWALS, (n + 1) * MAX_RENEWALS) }));
}

/** Renew control leases; false without a connection. */
export function renewLeases(drives) {
  renewMessages(drives).forEach(send);
  return socket?.readyState === WebSocket.OPEN;
}

function liveUrl() {
  const query = new URLSearchParams({ topics: patterns().join(","), interval: String(INTERVAL_S) });
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/v1/live?${query}`;
}

function onMessage(event) {
  lastMessageAt = nowMs();
  try {
    apply(JSON.parse(event.data));
  } catch (error) {
    console.error(error);
    onLost(); // values that a message did not change any more are not live
  }
}

function apply(message) {
  if (message.type === "closed") closedText.value = message.text ?? null;
  if (message.type === "delta") applyDelta(message);
  if (message.type !== "snapshot") return;
  applySnapshot(message);
  markLive();
}

function markLive() {
  reconnectDelay_ms = MIN_RECONNECT_DELAY_MS;
  snapshotTimeout_ms = SNAPSHOT_TIMEOUT_MS;
  connection.value = "live";
  lostAt.value = null;
  closedText.value = null;
}

function markLost() {
  if (connection.peek() !== "lost") lostAt.value = lastMessageAt || nowMs();
  connection.value = "lost";
}

function closeSocket() {
  if (!socket) return;
  socket.onmessage = null;
  socket.onclose = null;
  socket.close();
  socket = null;
}

/** Close a connection that was lost, and schedule a reconnect. */
function onLost() {
  closeSocket();
  markLost();
  scheduleReconnect();
}

function scheduleReconnect() {
  clearTimeout(reconnectTimer);
  if (!loggedIn.peek()) return;
  reconnectTimer = setTimeout(openSocket, reconnectDelay_ms * (0.75 + Math.random() / 2));
  reconnectDelay_ms = Math.min(reconnectDelay_ms * 2, MAX_RECONNECT_DELAY_MS);
}

/** Return whether the server answers; if not, schedule a reconnect. */
async function probe() {
  const answers = await loadSession().then(() => true, () => false);
  if (!answers) scheduleReconnect();
  return answers;
}

async function openSocket() {
  clearTimeout(reconnectTimer);
  // The session may be over, or the server another one: a refused WebSocket has no reason.
  if (connection.peek() === "lost" && !(await probe())) return;
  if (!loggedIn.peek() || socket) return;
  openedAt = nowMs();
  socket = new WebSocket(liveUrl());
  socket.onmessage = onMessage;
  socket.onclose = ({ code }) => {
    if (code === SESSION_ENDED_CODE) endText.value = closedText.peek();
    onLost();
  };
}

/** Reconnect at once, after a user's request or when the network is back. */
export function reconnect() {
  reconnectDelay_ms = MIN_RECONNECT_DELAY_MS;
  if (!isLive.peek() && !socket) openSocket();
}

function tick() {
  noticeSleep();
  now.value = nowMs();
  if (!socket) return;
  if (isLive.peek()) {
    if (nowMs() - lastMessageAt > MESSAGE_TIMEOUT_MS) onLost();
  } else if (nowMs() - openedAt > snapshotTimeout_ms) {
    snapshotTimeout_ms = Math.min(snapshotTimeout_ms * 2, MAX_SNAPSHOT_TIMEOUT_MS);
    onLost();
  }
}

/** Follow the session: connected while a user is logged in. */
export function startLiveConnection() {
  setInterval(tick, 500);
  addEventListener("online", reconnect);
  document.addEventListener("visibilitychange", () => { if (!document.hidden) reconnect(); });
  session.subscribe(() => {
    if (loggedIn.peek() && !socket && connection.peek() === "starting") openSocket();
    if (!loggedIn.peek()) disconnect();
  });
}

/** Close the connection of a session that has ended, and drop its values. */
function disconnect() {
  clearTimeout(reconnectTimer);
  applySnapshot({ topics: {} });
  closeSocket();
  lastMessageAt = 0;
  connection.value = "starting";
}
