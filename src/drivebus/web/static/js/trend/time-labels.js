// Labels of a time axis. Pure; formatters are cached because creating one is slow.

const cachedFormats = new Map();

function formatter(locale, shape) {
  const key = `${locale} ${JSON.stringify(shape)}`;
  if (!cachedFormats.has(key)) cachedFormats.set(key, new Intl.DateTimeFormat(locale, shape));
  return cachedFormats.get(key);
}

const CLOCK = { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
const SECONDS = { ...CLOCK, second: "2-digit" };
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
