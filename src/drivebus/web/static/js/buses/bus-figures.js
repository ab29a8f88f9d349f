// Shares, times and counts of the buses as text.
import { hasKey, t } from "../i18n.js";
import { NO_VALUE } from "../format.js";
import { isLive } from "../live.js";

/** Percent of its time from which a bus has hardly any left: polls may come late. */
const FULL_PERCENT = 90;

/** A bus as it may be shown now: without its port or a live connection, its load is not known. */
export function knownBus(view) {
  if (!view || (view.is_open && isLive.value)) return view;
  const stations = view.stations.map((station) => ({ ...station, load_percent: null }));
  return { ...view, load_percent: null, occupied_percent: null, transactions_per_s: null, stations };
}

export const isFull = (view) => view.occupied_percent !== null && view.occupied_percent >= FULL_PERCENT;

/** A share of 1 as "0.3 %"; small shares keep one significant digit. */
export function percent(share) {
  if (typeof share !== "number") return NO_VALUE;
  const value = share * 100;
  return `${value === 0 ? "0" : value < 0.1 ? "< 0.1" : value.toFixed(1)} %`;
}

/** Seconds as milliseconds, or as seconds from 10 s on. */
export function milliseconds(seconds) {
  if (typeof seconds !== "number") return NO_VALUE;
  if (seconds >= 10) return `${seconds.toFixed(0)} s`;
  const value = seconds * 1000;
  return `${value < 10 ? value.toFixed(1) : value.toFixed(0)} ms`;
}

/** `{NoReply: 3, ChecksumError: 1}` as "no reply 3, checksum 1"; the class's own name where the catalogue has none. */
export function classes(counts, what) {
  const found = Object.entries(counts ?? {}).filter(([, count]) => count > 0).sort(([, one], [, other]) => other - one);
  return found.map(([name, count]) => `${wordOf(name, what)} ${count}`).join(t("language.between_items"));
}

function wordOf(name, what) {
  const key = `page.${what}_${name.replace(/(?<=[a-z])(?=[A-Z])/g, "_").toLowerCase()}`;
  return hasKey(key) ? t(key) : name;
}
