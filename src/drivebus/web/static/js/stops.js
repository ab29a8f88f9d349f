// Stops: by REST alone, so that they work without a live connection. No lease, no second step, no dialog. The outcome
// of each is shown.
import { batch, signal } from "./lib.js";
import { api } from "./api.js";
import { loadSession } from "./session.js";
import { localized, t, titleOf } from "./i18n.js";
import { drive, group, nowMs } from "./store.js";
import { listed } from "./parts/selection.js";

/** A stop may take the drive's whole ramp until it is confirmed. */
const STOP_TIMEOUT_MS = 120_000;
/** Retry window of a stop while the server cannot be reached: a stop of minutes ago is no longer expected. */
const RETRY_WINDOW_MS = 30_000;
const RETRY_PAUSE_MS = 700;
const MAX_ENTRIES = 5;

/** Newest first: {id, what, how, phase: "sending" | "trying" | "done" | "failed", good, acknowledged, text(), time_ms,
 * withheld}. `withheld`: the drives to which nothing was sent because they did not answer as their model. */
export const stops = signal([]);
let count = 0;

const PATHS = {
  drive: (id) => `/drives/${encodeURIComponent(id)}/stop`,
  group: (id) => `/groups/${encodeURIComponent(id)}/stop`,
  all: () => "/stop",
};

export function nameOf({ kind, id }) {
  if (kind === "all") return t("page.stop_scope_all");
  const found = (kind === "drive" ? drive(id) : group(id)).value;
  return found ? titleOf(found) : id;
}

function change(id, fields) {
  stops.value = stops.peek().map((one) => (one.id === id ? { ...one, ...fields } : one));
}

/** Stop a drive ("drive", id), a group ("group", id) or everything ("all"). `how` of a drive: "stop", "coast" or
 * "quick_stop". `assume_model` sends it also to a station that has not answered as its model. Never raises. */
export async function stop(kind, id = null, how = "stop", { assume_model = false } = {}) {
  const mine = ++count;
  const entry = { id: mine, what: { kind, id }, how, phase: "sending", good: null, text: null, time_ms: Date.now() };
  stops.value = [entry, ...stops.peek()].slice(0, MAX_ENTRIES);
  const body = kind === "drive" ? { how, ...(assume_model ? { assume_model } : {}) } : {};
  const result = await sendUntilAnswered(mine, PATHS[kind](id), body);
  batch(() => change(mine, result));
}

/** No answer, no service process, or the CSRF token of an earlier server process: the stop is repeated. */
const isTransient = (error) => error.unreachable || error.status === 503 || error.code === "auth.csrf";

async function sendUntilAnswered(mine, path, body) {
  const until = nowMs() + RETRY_WINDOW_MS;
  let renewed = false;
  for (;;) {
    try {
      return evaluateStop(await api.post(path, body, { timeout_ms: STOP_TIMEOUT_MS }));
    } catch (error) {
      // Another tab logged in meanwhile: the request was denied before it had any effect.
      if (error.code === "auth.csrf" && !renewed) {
        renewed = true;
        await loadSession().catch(() => null);
        continue;
      }
      if (!isTransient(error) || nowMs() > until) return failed(error, stops.peek().find((one) => one.id === mine)?.what);
      change(mine, { phase: "trying" });
      await new Promise((resolve) => { setTimeout(resolve, RETRY_PAUSE_MS); });
      // Another server process may need another CSRF token.
      await loadSession().catch(() => null);
    }
  }
}

/** An error with an outcome: sent and not confirmed. Without one it is unknown whether the stop was sent. */
function failed(error, what) {
  const withheld = what?.kind === "drive" && isWithheld(error) ? [what.id] : [];
  return { phase: error.outcome ? "done" : "failed", good: false, withheld, text: () => error.sentence ?? String(error) };
}

const WITHHELD_KEYS = new Set(["drives.stop_withheld", "drives.stop_withheld_silent"]);

/** Was nothing sent because the station did not answer as its model? */
const isWithheld = (found) => WITHHELD_KEYS.has(found.outcome?.key ?? found.key);

const classOf = (found) => (["confirmed", "acknowledged"].includes(found.status) ? found.status : "unconfirmed");

/** Result of a stop from any of the three shapes of an answer: one outcome, outcomes by drive, buses. `good`: no drive
 * is left unconfirmed; `acknowledged`: a drive accepted the stop and cannot report standstill. */
export function evaluateStop(answer) {
  if (answer.outcome) {
    const found = classOf(answer.outcome);
    const text = () => localized(answer.outcome.text);
    return { phase: "done", good: found !== "unconfirmed", acknowledged: found === "acknowledged", text };
  }
  const drives = { confirmed: new Set(), acknowledged: new Set(), unconfirmed: new Set() };
  for (const [id, one] of Object.entries(answer.outcomes ?? {})) drives[classOf(one)].add(id);
  for (const [id, bus] of Object.entries(answer.buses ?? {})) {
    for (const one of bus.unconfirmed ?? []) drives.unconfirmed.add(one);
    if (!bus.confirmed && !bus.unconfirmed?.length && !bus.acknowledged?.length) drives.unconfirmed.add(id);
  }
  const { acknowledged, unconfirmed } = drives;
  const named = (ids) => ({ n: ids.size, names: listed([...ids]) });
  if (unconfirmed.size > 0) {
    const withheld = Object.entries(answer.outcomes ?? {}).filter(([, one]) => isWithheld(one)).map(([id]) => id);
    const text = () => t("page.stop_unconfirmed", named(unconfirmed));
    return { phase: "done", good: false, acknowledged: false, withheld, text };
  }
  if (acknowledged.size > 0) {
    return { phase: "done", good: true, acknowledged: true, text: () => t("page.stop_acknowledged", named(acknowledged)) };
  }
  const key = drives.confirmed.size > 0 ? "page.stop_all_confirmed" : "page.stop_no_drives";
  return { phase: "done", good: drives.confirmed.size > 0, acknowledged: false, text: () => t(key) };
}
