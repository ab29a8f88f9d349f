// Values and state of a drive as they may be shown now. Ages are computed here, from the time of each reply on this
// page's clock.
import { isLive, now } from "./live.js";

/** A value of a drive as it may be shown now, with its present age; without a live connection its quality is bad, and a
 * good one of an offline drive is uncertain: several polls may fail before it is too old.
 * `{value, unit, quality, reason, source_time_ms, age_s}`; null where the drive has no such signal. */
export const reading = (view, name) => readingWithAge(view, name, ageOf);

/** `reading` without its age, for hundreds of tiles that must not be redrawn at every tick. */
export const readingWithoutAge = (view, name) => readingWithAge(view, name, () => null);

function readingWithAge(view, name, age) {
  const found = view?.signals?.[name];
  if (!found) return null;
  if (!isLive.value) return { ...found, quality: "bad", reason: "page.link_lost", age_s: age(found) };
  const isLast = found.quality === "good" && view.presence === "offline";
  return { ...found, ...isLast && { quality: "uncertain", reason: "page.before_offline" }, age_s: age(found) };
}

/** Seconds since the reply that a value came from. Follows the page's tick. */
export function ageOf(found) {
  return found.readAt === null ? null : Math.max(0, now.value - found.readAt) / 1000;
}

/** The drive's state as it may be shown now; `lost` without a live connection, `beforeStop` where it was read before the
 * last stop. */
export const stateOf = (view) => ({
  state: view.state, presence: view.presence, unusable: Boolean(view.unusable_reply), lost: !isLive.value,
  beforeStop: (view.last_stop?.time_ms ?? 0) > (view.state_time_ms ?? 0),
});

/** Intervals below this are what a user expects of a live value. */
const EXPECTED_INTERVAL_S = 1.5;

/** Seconds between two polls of a drive that its bus polls less often than its model asks for; else null. */
export function slowInterval({ poll_interval_s: real, requested_interval_s: requested }) {
  return real > EXPECTED_INTERVAL_S && real > requested ? real : null;
}
