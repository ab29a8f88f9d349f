// Formats of times in charts and their tables. Pure; formatters are cached because creating one is slow.

const cachedFormats = new Map();

function formatter(locale, shape) {
  const key = `${locale} ${JSON.stringify(shape)}`;
  if (!cachedFormats.has(key)) cachedFormats.set(key, new Intl.DateTimeFormat(locale, shape));
  return cachedFormats.get(key);
}

const CLOCK = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
const SECONDS = { ...CLOCK, second: "2-digit" };
const digits = (n, count = 2) => String(n).padStart(count, "0");
const DAY = { month: "short", day: "numeric" };
const MONTH = { year: "numeric", month: "short" };
const HOUR_MS = 3_600_000;
const DAY_MS = 24 * HOUR_MS;

/** The first line below a tick: as fine as the span needs. A tick may lie a part of a millisecond before its second. */
export function timeLabel(tick, span, locale) {
  const at = Math.round(tick);
  if (span > 200 * DAY_MS) return formatter(locale, MONTH).format(at);
  if (span > 4 * DAY_MS) return formatter(locale, DAY).format(at);
  return formatter(locale, span > HOUR_MS / 2 ? CLOCK : SECONDS).format(at);
}

/** The second line: the day or the year that the first one leaves out. */
export function dayLine(tick, span, locale) {
  const at = Math.round(tick);
  if (span > 200 * DAY_MS) return "";
  if (span > 4 * DAY_MS) return formatter(locale, { year: "numeric" }).format(at);
  return formatter(locale, DAY).format(at);
}

/** A local time of day, "14:03:22", with milliseconds where `isFine`. */
export function clock(at, isFine = false) {
  const date = new Date(at);
  const time = [date.getHours(), date.getMinutes(), date.getSeconds()].map((n) => digits(n)).join(":");
  return isFine ? `${time}.${digits(date.getMilliseconds(), 3)}` : time;
}

/** "2026-11-05 14:03:22": local time in the order of ISO 8601, in which day and month can't be confused. */
export function moment(at, isFine = false) {
  const date = new Date(at);
  const day = [date.getFullYear(), date.getMonth() + 1, date.getDate()].map((n) => digits(n)).join("-");
  return `${day} ${clock(at, isFine)}`;
}

/** A moment as an input of type datetime-local takes it, in local time. */
export function forInput(at) {
  const local = new Date(at - new Date(at).getTimezoneOffset() * 60_000);
  return local.toISOString().slice(0, 19);
}

/** The two largest units of a duration: "3 min 20 s". `unit(name)` is the text of a unit. */
export function duration(span, unit) {
  const parts = [["d", DAY_MS], ["h", HOUR_MS], ["min", 60_000], ["s", 1000]];
  let rest = Math.round(Math.abs(span) / 100) * 100; // before it is divided: 59.96 s are a minute
  const found = [];
  for (const [name, size] of parts) {
    const count = name === "s" ? rest / size : Math.floor(rest / size);
    rest -= count * size;
    if (count && found.length < 2) found.push(`${count} ${unit(name)}`);
  }
  return (span < 0 ? "−" : "") + (found.join(" ") || `0 ${unit("s")}`);
}
