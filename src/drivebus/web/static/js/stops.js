// Stops: by REST alone, so that they work without a live connection. No lease, no second step, no dialog. The outcome
// of each is shown.
import { batch, signal } from "./lib.js";
import { api } from "./api.js";
import { loadSession } from "./session.js";
import { localized, t, titleOf } from "./i18n.js";
import { drive, group, nowMs } from "./store.js";

/** A stop may take the drive's whole ramp until it is confirmed. */
const STOP_TIMEOUT_MS = 120_000;
/** Retry window of a stop while the server cannot be reached: a stop of minutes ago is no longer expected. */
const RETRY_WINDOW_MS = 30_000;
const RETRY_PAUSE_MS = 700;
const MAX_ENTRIES = 5;

/** Newest first: {id, what, phase: "sending" | "trying" | "done" | "failed", good, text(), time_ms}. */
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
 * "quick_stop". Never raises. */
export async function stop(kind, id = null, how = "stop") {
  const mine = ++count;
  const entry = { id: mine, what: { kind, id }, phase: "sending", good: null, text: null, time_ms: Date.now() };
  stops.value = [entry, ...stops.peek()].slice(0, MAX_ENTRIES);
  const result = await sendUntilAnswered(mine, PATHS[kind](id), kind === "drive" ? { how } : {});
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
      if (!isTransient(error) || nowMs() > until) return failed(error);
      change(mine, { phase: "trying" });
      await new Promise((resolve) => { setTimeout(resolve, RETRY_PAUSE_MS); });
      // Another server process may need another CSRF token.
      await loadSession().catch(() => null);
    }
  }
}

/** An error with an outcome: sent and not confirmed. Without one it is unknown whether the stop was sent. */
function failed(error) {
  return { phase: error.outcome ? "done" : "failed", good: false, text: () => error.sentence ?? String(error) };
}

const isConfirmed = (found) => found.status === "confirmed" || found.status === "acknowledged";

/** Result of a stop from any of the three shapes of an answer: one outcome, outcomes by drive, buses. */
export function evaluateStop(answer) {
  if (answer.outcome) return { phase: "done", good: isConfirmed(answer.outcome), text: () => localized(answer.outcome.text) };
  const outcomes = Object.entries(answer.outcomes ?? {});
  const named = new Set(Object.values(answer.buses ?? {}).flatMap((bus) => bus.unconfirmed ?? []));
  for (const [id, one] of outcomes) if (!isConfirmed(one)) named.add(id);
  const unnamed = Object.entries(answer.buses ?? {}).filter(([, bus]) => !bus.confirmed && !bus.unconfirmed?.length);
  for (const [id] of unnamed) named.add(id);
  if (named.size === 0) return { phase: "done", good: true, text: () => t("page.stop_all_confirmed") };
  const names = () => [...named].map((id) => nameOf({ kind: "drive", id })).join(t("page.comma"));
  return { phase: "done", good: false, text: () => t("page.stop_unconfirmed", { names: names() }) };
}
