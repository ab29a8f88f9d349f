// Current state of the plant: one signal per topic, so that a change redraws only what shows that topic.
import { batch, computed, signal } from "./lib.js";

/** Topics published to their signals in one frame of the screen: 300 drives change in one message, and the page stays
 * smooth. */
const TOPICS_PER_FRAME = 40;
/** Newest items kept of a feed (frames, events). */
const MAX_FEED_ITEMS = 500;

const topics = new Map();
const names = signal([]);
const hasSnapshot = signal(false);
/** Newest values that are not in their signals yet, in the order of publication: the topic that has waited longest first. */
const pending = new Map();
let isScheduled = false;

/** The signal of a topic: its object, or null while (or after) there is none. */
export function topic(name) {
  if (!topics.has(name)) topics.set(name, signal(null));
  return topics.get(name);
}

const idLists = new Map();

/** A signal of the ids under "drives", "buses" or "groups"; changes only when one comes or goes. */
export function idsOf(kind) {
  if (!idLists.has(kind)) {
    const start = `${kind}/`;
    idLists.set(kind, computed(() => names.value.filter((name) => name.startsWith(start))
      .map((name) => name.slice(start.length))));
  }
  return idLists.get(kind);
}
/** Whether a snapshot has come and the plant has no such topic: one that it has may reach its signal some frames later. */
export const isAbsent = (name) => topic(name).value === null && newest(name) === null && hasSnapshot.value;
export const drive = (id) => topic(`drives/${id}`);
export const bus = (id) => topic(`buses/${id}`);
export const group = (id) => topic(`groups/${id}`);

/** Milliseconds of this page's own clock, never of the server's. */
export const nowMs = () => performance.now() + slept_ms;

/** A difference of the clocks beyond this is a sleep; smaller ones are corrections of the wall clock. */
const SLEEP_THRESHOLD_MS = 5000;
let slept_ms = 0;
let lastClocks = { page_ms: performance.now(), wall_ms: Date.now() };

/** Add a sleep of the machine to the page's clock: the browser's clock may stop meanwhile, the wall clock does not.
 * Called at every tick. */
export function noticeSleep() {
  const at = { page_ms: performance.now(), wall_ms: Date.now() };
  const missed_ms = at.wall_ms - lastClocks.wall_ms - (at.page_ms - lastClocks.page_ms);
  if (missed_ms > SLEEP_THRESHOLD_MS) slept_ms += missed_ms;
  lastClocks = at;
}

let serviceOffset_ms = null;

/** The plant's UTC milliseconds now, by its last message: for the right edge of charts and for labels only. */
export const serviceNow = () => Math.round(serviceOffset_ms === null ? Date.now() : nowMs() + serviceOffset_ms);

/** `signals` with `readAt`: the moment of each reply on this page's clock, by the service's clock in its message. */
const withReadTime = (signals, at, time_ms) => Object.fromEntries(
  Object.entries(signals).map(([name, found]) => [name, {
    ...found, readAt: found.source_time_ms === null ? null : at - Math.max(0, time_ms - found.source_time_ms),
  }]),
);

/** Merge changed signals; null stands for one that the drive no longer has. */
function mergeSignals(old, changed, at, time_ms) {
  const there = Object.entries(changed).filter(([, found]) => found !== null);
  const merged = { ...old, ...withReadTime(Object.fromEntries(there), at, time_ms) };
  return Object.fromEntries(Object.entries(merged).filter(([name]) => changed[name] !== null));
}

/** Append to a feed, {items, missed}: the newest items, and the number of items dropped on the way. */
function appendItems(old, news) {
  const items = [...(old?.items ?? []), ...news].slice(-MAX_FEED_ITEMS);
  return { items, missed: old?.missed ?? 0 };
}

const isFeed = (name) => name === "events" || name.startsWith("frames/");

/** Merge `change` into `old`: top-level keys whole, signals one by one, feeds appended. */
export function mergeTopic(name, old, change, at, time_ms) {
  if (isFeed(name)) return appendItems(old, change);
  const now = { ...old, ...change };
  if (change.signals) now.signals = mergeSignals(old?.signals, change.signals, at, time_ms);
  return now;
}

function publishPending() {
  isScheduled = false;
  const slice = document.hidden ? pending.size : TOPICS_PER_FRAME;
  batch(() => {
    for (const [name, value] of [...pending].slice(0, slice)) {
      pending.delete(name);
      topic(name).value = value;
    }
    updateNames();
  });
  if (pending.size) schedulePublish();
}

/** Topic → its place in the configuration. A topic without one, because it was requested before the first snapshot, is last. */
let topicOrder = new Map();
const orderOf = (name) => topicOrder.get(name) ?? topicOrder.size;

function updateNames() {
  const there = [...topics.keys()].filter((name) => topics.get(name).peek() !== null);
  const now = there.sort((one, other) => orderOf(one) - orderOf(other));
  if (now.length !== names.peek().length || now.some((name, n) => name !== names.peek()[n])) names.value = now;
}

function schedulePublish() {
  if (isScheduled) return;
  isScheduled = true;
  if (document.hidden) setTimeout(publishPending, 0);
  else requestAnimationFrame(publishPending);
}

// A hidden page gets no animation frames: pending topics are drawn at once.
document.addEventListener("visibilitychange", () => { if (isScheduled) publishPending(); });

/** A topic that waits keeps its place: one that changes in each message would else never be published on a slow screen. */
function queueTopic(name, value) {
  pending.set(name, value);
  schedulePublish();
}

/** Newest value of a topic, which may reach its signal some frames later. */
export const newest = (name) => (pending.has(name) ? pending.get(name) : topic(name).peek());

/** Apply a snapshot of all subscribed topics; topics that it lacks are removed. */
export function applySnapshot(message) {
  topicOrder = new Map(Object.keys(message.topics).map((name, n) => [name, n]));
  for (const name of topics.keys()) if (!(name in message.topics) && newest(name) !== null) queueTopic(name, null);
  addTopics(message, () => null);
  hasSnapshot.value = topicOrder.size > 0;
}

/** Apply a delta: changed topics, numbers of missed feed items, and removed topics. */
export function applyDelta(message) {
  addTopics(message, newest);
  for (const [name, n] of Object.entries(message.missed ?? {})) {
    queueTopic(name, { items: [], ...newest(name), missed: (newest(name)?.missed ?? 0) + n });
  }
  for (const name of message.removed ?? []) queueTopic(name, null);
}

function addTopics(message, oldOf) {
  const at = nowMs();
  if (typeof message.time_ms === "number") serviceOffset_ms = message.time_ms - at;
  for (const [name, change] of Object.entries(message.topics)) {
    queueTopic(name, mergeTopic(name, oldOf(name), change, at, message.time_ms));
  }
}
