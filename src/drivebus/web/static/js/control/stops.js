// Stops: by REST alone, so that they work without a live connection. No lease, no second step, no dialog. The outcome
// of each is shown.
import { effect, signal } from "../lib.js";
import { api, drivePath, groupPath } from "../api.js";
import { OFF_STATES } from "../drive-states.js";
import { loadSession } from "../session.js";
import { localized, t, titleOf } from "../i18n.js";
import { drive, group, idsOf, nowMs, serviceNow } from "../store.js";
import { listDrives } from "../titles.js";

/** A stop may take the drive's whole ramp until it is confirmed. */
const STOP_TIMEOUT_MS = 120_000;
/** Retry window of a stop while the server cannot be reached: a stop of minutes ago is no longer expected. */
const RETRY_WINDOW_MS = 30_000;
const RETRY_PAUSE_MS = 700;
/** A stop that a newer one replaces keeps its connection for this long: long enough to reach the server on a slow line. A
 * browser has six connections to a server: more stops that wait for their motors would keep the next one in the browser. */
const REPLACED_STOP_MS = 3000;
/** A read this long after the answer is not one that the stop itself had: the service's clock is known to a message's delay. */
const CONFIRM_AFTER_MS = 1000;

/** Stops of this page, newest first: {id, target, how, phase: "sending" | "trying" | "done" | "failed", good, acknowledged,
 * text(unconfirmed), time_ms, unconfirmed, acknowledgedDrives, withheld, answered_ms}. `target`: {kind, id, title}, as for `stop`;
 * `unconfirmed`: the drives whose stop is not confirmed; `withheld`: those to which nothing was sent because they did not
 * answer as their model. An older stop stays in the list until it is confirmed, dismissed, or sent again. */
export const stops = signal([]);
let count = 0;
/** AbortController of the request of each stop without an answer yet, by the id of the stop. */
const underWay = new Map();

const PATHS = { drive: (id) => drivePath(id, "/stop"), group: (id) => groupPath(id, "/stop"), all: () => "/stop" };

const viewOf = ({ kind, id }) => (kind === "drive" ? drive(id) : group(id));

/** Name of what is stopped; after the end of a session, which drops its drives, by the `title` from before. */
export function targetName({ kind, id, title }) {
  return kind === "all" ? t("page.stop_scope_all") : titleOf(viewOf({ kind, id }).value ?? { id, title });
}

/** Whether a new stop replaces the result of an older one: it stops at least the same drives. */
function covers(newer, older) {
  if (newer.kind === "all" || (newer.kind === older.kind && newer.id === older.id)) return true;
  return newer.kind === "group" && older.kind === "drive" && (group(newer.id).peek()?.drives.includes(older.id) ?? false);
}

const isSettled = (entry) => entry.phase === "done" && entry.good && !entry.acknowledged;

/** Stops whose result is to be read: the newest, and each older one that is not confirmed. */
export const shownStops = () => stops.value.filter((entry, n) => n === 0 || !isSettled(entry));

/** Stops of which nothing good is known yet. */
export const openStops = () => stops.value.filter((entry) => entry.phase !== "done" || !entry.good);

export function dismissStop(id) {
  stops.value = stops.peek().filter((entry, n) => entry.id !== id && (n === 0 || !isSettled(entry)));
}

function change(id, fields) {
  stops.value = stops.peek().map((entry) => (entry.id === id ? { ...entry, ...fields } : entry));
}

/** Stop a drive ("drive", id), a group ("group", id) or everything ("all"). `how` of a drive: "stop", "coast" or
 * "quick_stop". `assume_model` sends it also to a station that has not answered as its model. Never raises. */
export async function stop(kind, id = null, how = "stop", { assume_model = false } = {}) {
  const entryId = ++count;
  const target = { kind, id, title: id === null ? undefined : viewOf({ kind, id }).peek()?.title };
  const entry = { id: entryId, target, how, phase: "sending", good: null, text: null, time_ms: serviceNow() };
  const replaced = stops.peek().filter((older) => covers(entry.target, older.target));
  setTimeout(() => replaced.forEach(({ id: replacedId }) => underWay.get(replacedId)?.abort()), REPLACED_STOP_MS);
  stops.value = [entry, ...stops.peek().filter((older) => !isSettled(older) && !replaced.includes(older))];
  const body = kind === "drive" ? { how, ...(assume_model ? { assume_model } : {}) } : {};
  const request = new AbortController();
  underWay.set(entryId, request);
  const result = await sendUntilAnswered(entryId, entry.target, body, request.signal);
  underWay.delete(entryId);
  change(entryId, { ...result, answered_ms: serviceNow() });
}

/** Whether a read after the answer has shown the output off, and the stop is no longer repeated. Reads of a station that
 * does not answer as its model show nothing. */
function isConfirmedSince(id, { answered_ms, withheld }) {
  const view = drive(id).value;
  return view?.presence === "online" && !view.stop_pending && OFF_STATES.includes(view.state)
    && view.state_time_ms > answered_ms + CONFIRM_AFTER_MS && !withheld?.includes(id);
}

function confirmedLater({ acknowledgedDrives = [] }) {
  const done = { unconfirmed: [], good: true, time_ms: serviceNow() };
  if (acknowledgedDrives.length > 0) return { ...done, ...acknowledgedBy(acknowledgedDrives) };
  return { ...done, text: () => t("page.stop_confirmed_later") };
}

// A drive that is confirmed is no longer named; a start of it afterwards does not make its stop unconfirmed again.
effect(() => {
  for (const entry of stops.value.filter(({ phase, unconfirmed }) => phase === "done" && unconfirmed?.length > 0)) {
    const left = entry.unconfirmed.filter((id) => !isConfirmedSince(id, entry));
    if (left.length === 0) change(entry.id, confirmedLater(entry));
    else if (left.length < entry.unconfirmed.length) change(entry.id, { unconfirmed: left });
  }
});

/** Whether a stop is repeated after an error: no answer, no service process, or the CSRF token of an earlier server process. */
const isTransient = (error) => error.unreachable || error.status === 503 || error.code === "auth.csrf";

async function sendUntilAnswered(entryId, target, body, replacement) {
  const path = PATHS[target.kind](target.id);
  const until = nowMs() + RETRY_WINDOW_MS;
  let renewed = false;
  for (;;) {
    try {
      const options = { timeout_ms: STOP_TIMEOUT_MS, signal: replacement };
      return evaluateStop(await api.post(path, body, options), target);
    } catch (error) {
      // Another tab logged in meanwhile: the request was denied before it had any effect.
      if (error.code === "auth.csrf" && !renewed) {
        renewed = true;
        await loadSession().catch(() => null);
        continue;
      }
      if (!isTransient(error) || nowMs() > until || replacement.aborted) return failed(error, target);
      change(entryId, { phase: "trying" });
      await new Promise((resolve) => { setTimeout(resolve, RETRY_PAUSE_MS); });
      // Another server process may need another CSRF token. Where it answers, the next request waits for the motors.
      if (await loadSession().then(() => true, () => false)) change(entryId, { phase: "sending" });
    }
  }
}

/** An error with an outcome: sent and not confirmed. Without one it is unknown whether the stop was sent. */
function failed(error, target) {
  const named = target.kind === "drive" ? [target.id] : [];
  const withheld = isWithheld(error) ? named : [];
  const text = () => error.sentence ?? String(error);
  return { phase: error.outcome ? "done" : "failed", good: false, unconfirmed: named, withheld, text };
}

const WITHHELD_KEYS = new Set(["drives.stop_withheld", "drives.stop_withheld_silent"]);

/** Whether nothing was sent because the station did not answer as its model. */
const isWithheld = (found) => WITHHELD_KEYS.has(found.outcome?.key ?? found.key);

const classOf = (found) => (["confirmed", "acknowledged"].includes(found.status) ? found.status : "unconfirmed");

const countAndNames = (ids) => ({ n: ids.length, names: listDrives(ids) });

const acknowledgedBy = (ids) => ({ acknowledged: true, text: () => t("page.stop_acknowledged", countAndNames(ids)) });

/** Drives of a bus whose stop failed as a whole; the bus itself where the page knows none. */
function drivesOfBus(id) {
  const drives = idsOf("drives").peek().filter((driveId) => drive(driveId).peek()?.bus === id);
  return drives.length > 0 ? drives : [id];
}

/** Result of a stop from any of the three shapes of an answer: one outcome, outcomes by drive, buses. `good`: no drive
 * is left unconfirmed; `acknowledged`: a drive accepted the stop and cannot report standstill. */
export function evaluateStop(answer, target) {
  if (answer.outcome) {
    const found = classOf(answer.outcome);
    const text = () => localized(answer.outcome.text);
    const unconfirmed = found === "unconfirmed" && target?.kind === "drive" ? [target.id] : [];
    return { phase: "done", good: found !== "unconfirmed", acknowledged: found === "acknowledged", unconfirmed, text };
  }
  const drives = { confirmed: new Set(), acknowledged: new Set(), unconfirmed: new Set() };
  for (const [id, outcome] of Object.entries(answer.outcomes ?? {})) drives[classOf(outcome)].add(id);
  for (const [id, bus] of Object.entries(answer.buses ?? {})) {
    for (const driveId of bus.unconfirmed ?? []) drives.unconfirmed.add(driveId);
    if (!bus.confirmed && !bus.unconfirmed?.length && !bus.acknowledged?.length) {
      for (const driveId of drivesOfBus(id)) drives.unconfirmed.add(driveId);
    }
  }
  const unconfirmed = [...drives.unconfirmed];
  const acknowledgedDrives = [...drives.acknowledged].filter((id) => !drives.unconfirmed.has(id));
  if (unconfirmed.length > 0) {
    const withheld = Object.entries(answer.outcomes ?? {}).filter(([, outcome]) => isWithheld(outcome)).map(([id]) => id);
    const text = (left = unconfirmed) => t("page.stop_unconfirmed", countAndNames(left));
    return { phase: "done", good: false, acknowledged: false, unconfirmed, acknowledgedDrives, withheld, text };
  }
  if (acknowledgedDrives.length > 0) return { phase: "done", good: true, ...acknowledgedBy(acknowledgedDrives) };
  const key = drives.confirmed.size > 0 ? "page.stop_all_confirmed" : "page.stop_no_drives";
  return { phase: "done", good: drives.confirmed.size > 0, acknowledged: false, text: () => t(key) };
}
