// Numbers, durations and times as text.
import { t } from "./i18n.js";

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
export function quantity(value, unit) {
  return `${number(value, unit)}${unit && value !== null && value !== undefined ? ` ${unit}` : ""}`;
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

const padded = (n, count = 2) => String(n).padStart(count, "0");

/** A local time of day, "14:03:22", with milliseconds where `isFine`. */
export function clock(at, isFine = false) {
  if (at === null || at === undefined) return NO_VALUE;
  const date = new Date(at);
  const time = [date.getHours(), date.getMinutes(), date.getSeconds()].map((n) => padded(n)).join(":");
  return isFine ? `${time}.${padded(date.getMilliseconds(), 3)}` : time;
}

/** "2026-11-05 14:03:22": local time in the order of ISO 8601, in which day and month can't be confused. */
export function moment(at, isFine = false) {
  if (at === null || at === undefined) return NO_VALUE;
  const date = new Date(at);
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((n) => padded(n)).join("-");
  return `${day} ${clock(at, isFine)}`;
}

/** The two largest units of a span in ms: "3 min 20 s". */
export function spanText(span) {
  const parts = [["d", 86_400_000], ["h", 3_600_000], ["min", 60_000], ["s", 1000]];
  let rest = Math.round(Math.abs(span) / 100) * 100; // before it is divided: 59.96 s are a minute
  const found = [];
  for (const [name, size] of parts) {
    const count = name === "s" ? rest / size : Math.floor(rest / size);
    rest -= count * size;
    if (count && found.length < 2) found.push(`${count} ${t(`page.unit_${name}`)}`);
  }
  return (span < 0 ? "−" : "") + (found.join(" ") || `0 ${t("page.unit_s")}`);
}
