// Numbers, ages and times as text. Ages are computed here from the time of each reply on this page's clock; times of
// day are labels only.
import { signal } from "./lib.js";
import { localized, hasKey, t } from "./i18n.js";
import { now, isLive } from "./live.js";
import * as labels from "./trend/labels.js";

const DIGITS = { Hz: 2, A: 2, V: 0, "°C": 0, "%": 1, kW: 2, kWh: 1, h: 1, s: 1, rpm: 0, "r/min": 0 };
export const NO_VALUE = "–";

/** A number with the digits of its unit; "–" for null. Whole numbers of no unit stay whole. */
export function number(value, unit = "", digits = DIGITS[unit]) {
  if (value === null || value === undefined) return NO_VALUE;
  if (typeof value !== "number") return String(value);
  if (digits === undefined) return String(Number.isInteger(value) ? value : Number(value.toPrecision(6)));
  return value.toFixed(digits);
}

const FULLWIDTH = /[\uFF10-\uFF19\uFF0E\uFF0B\uFF0D]/g;
const toHalfwidth = (wide) => String.fromCharCode(wide.charCodeAt(0) - 0xFEE0);

/** The number of a text, also in fullwidth digits; null for anything else. "1,5" is rejected, because the browser's
 * own number fields drop the comma and would make 15 of it. */
export function numberOf(text) {
  const plain = String(text).trim().replace(FULLWIDTH, toHalfwidth);
  return /^[+-]?(\d+\.?\d*|\.\d+)$/.test(plain) ? Number(plain) : null;
}

/** "25.00 Hz". */
export function quantity(value, unit, digits) {
  return `${number(value, unit, digits)}${unit && value !== null && value !== undefined ? ` ${unit}` : ""}`;
}

/** "3 s", "4 min", "2 h", "5 d" in the reader's language. */
export function duration(seconds) {
  if (seconds === null || seconds === undefined) return NO_VALUE;
  if (seconds < 10) return t("page.seconds", { n: seconds.toFixed(1) });
  if (seconds < 100) return t("page.seconds", { n: Math.floor(seconds) });
  if (seconds < 6000) return t("page.minutes", { n: Math.floor(seconds / 60) });
  if (seconds < 172_800) return t("page.hours", { n: Math.floor(seconds / 3600) });
  return t("page.days", { n: Math.floor(seconds / 86_400) });
}

const isMissing = (ms) => ms === null || ms === undefined;
/** Time of day of a UTC millisecond, in this browser's time zone. */
export const clock = (ms) => (isMissing(ms) ? NO_VALUE : labels.clock(ms));
/** Date and time. */
export const moment = (ms) => (isMissing(ms) ? NO_VALUE : labels.moment(ms));

/** A value of a drive as it may be shown now, with its present age; without a live connection its quality is bad.
 * `{value, unit, quality, reason, source_time_ms, age_s}`; null where the drive has no such signal. */
export const reading = (view, name) => readingWithAge(view, name, ageOf);

/** The same without its age, for hundreds of tiles that must not be redrawn at every tick. */
export const readingWithoutAge = (view, name) => readingWithAge(view, name, () => null);

function readingWithAge(view, name, age) {
  const found = view?.signals?.[name];
  if (!found) return null;
  if (!isLive.value) return { ...found, quality: "bad", reason: "page.link_lost", age_s: age(found) };
  return { ...found, age_s: age(found) };
}

/** Seconds since the reply that a value came from. Follows the page's tick. */
export function ageOf(found) {
  return found.readAt === null ? null : Math.max(0, now.value - found.readAt) / 1000;
}

/** The drive's state as it may be shown now; `lost` without a live connection, `beforeStop` where it was read before the
 * last stop. */
export const stateOf = (view) => ({
  state: view.state, presence: view.presence, lost: !isLive.value,
  beforeStop: (view.last_stop?.time_ms ?? 0) > (view.state_time_ms ?? 0),
});

/** Intervals below this are what a user expects of a live value. */
const EXPECTED_INTERVAL_S = 1.5;

/** Seconds between two polls of a drive that its bus polls less often than its model asks for; else null. */
export function slowInterval({ poll_interval_s: real, requested_interval_s: requested }) {
  return real > EXPECTED_INTERVAL_S && real > requested ? real : null;
}

/** The most used signals, in the order in which they are shown. */
const FIRST_SIGNALS = [
  "output_frequency", "output_current", "dc_bus_voltage", "output_voltage", "set_frequency",
];

/** To sort signals by that order; the others come after them. */
export const signalRank = (name) => (FIRST_SIGNALS.includes(name) ? FIRST_SIGNALS.indexOf(name) : FIRST_SIGNALS.length);

const profileSignalNames = signal({});

/** Add the names of a profile's signals: a list of {signal or name, text}. */
export function addSignalNames(list) {
  const news = list.filter((one) => one.text).map((one) => [one.signal ?? one.name, one.text]);
  profileSignalNames.value = { ...profileSignalNames.peek(), ...Object.fromEntries(news) };
}

/** Name of a signal in the reader's language: the catalogue's, else the profile's. */
export function signalName(name) {
  const key = `signal.${name}`;
  return hasKey(key) ? t(key) : localized(profileSignalNames.value[name]) || name.replaceAll("_", " ");
}
