// Samples of an incident, which do not change, for the same trend as live ones.
import { signal } from "../lib.js";
import { signalRank } from "../signal-names.js";
import { BAD } from "../quality.js";
import { appearanceOf } from "../drive/state-mark.js";

const BESIDE_MS = 1000;

/** `TrendSource` of an incident: `signals` {name: {t: [seconds before the trip], v, q}}. */
export class StaticSource {
  constructor(found) {
    this.isFixed = true;
    this.lines = [];
    const series = {};
    for (const [name, samples] of Object.entries(found.signals ?? {})) {
      if (!samples.v.some((value) => typeof value === "number")) continue;
      const tag = `${found.drive}.${name}`;
      this.lines.push({ tag, signal: name, unit: found.view?.signals?.[name]?.unit ?? "" });
      series[tag] = seriesOf(samples, found.time_ms);
    }
    this.lines.sort((a, b) => signalRank(a.signal) - signalRank(b.signal));
    this.window = { from: found.time_ms - found.before_s * 1000, to: found.time_ms + BESIDE_MS };
    this.series = signal(series);
    const trip = { id: found.id, time_ms: found.time_ms, kind: "fault", drive: found.drive, text: found.text,
      actor: null };
    const events = (found.events ?? []).filter((event) => event.time_ms < found.time_ms);
    this.markers = signal({ items: [...events, trip], isCut: false });
    this.trip_ms = found.time_ms;
    this.states = statesOf(found);
    this.resolution = signal("raw");
    this.state = signal("loaded");
    this.error = signal(null);
    this.fetchedWindow = this.window;
  }

  choose() {}

  load() {}

  takeLive() {}

  close() {}

  seriesWithLive() {
    return this.series.peek();
  }

  /** A recorded trend ends with its last sample. */
  end() {
    return -Infinity;
  }
}

/** States of the drive as stretches, each until the next one: `{from, to, isAlarm, text()}`. */
function statesOf({ states = [], time_ms }) {
  const at = (n) => time_ms + (states[n]?.t ?? BESIDE_MS / 1000) * 1000;
  return states.map(({ state, presence }, n) => {
    const [, tone] = appearanceOf({ state, presence });
    return { from: at(n), to: at(n + 1), isAlarm: tone === "alarm", text: () => appearanceOf({ state, presence })[2] };
  });
}

function seriesOf({ t, v, q }, at) {
  const values = v.map((value, n) => (typeof value === "number" && q[n] !== BAD ? value : null));
  return { t: t.map((seconds) => Math.round(at + seconds * 1000)), min: values, mean: values, max: values, q };
}
