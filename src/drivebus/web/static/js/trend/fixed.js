// Samples that do not change any more, shown by the same trend as live ones: those of a case.
import { signal } from "../lib.js";
import { BAD, GOOD, UNCERTAIN } from "./columns.js";

const QUALITIES = { good: GOOD, uncertain: UNCERTAIN, bad: BAD };

/** What `Source` is to the historian, for a case: `signals` {name: {unit, samples: [[time_ms, value, quality]]}}. */
export class Fixed {
  constructor(found) {
    this.isFixed = true;
    this.lines = [];
    const series = {};
    for (const [name, { unit, samples }] of Object.entries(found.signals ?? {})) {
      const tag = `${found.drive}.${name}`;
      if (!samples.some(([, value]) => typeof value === "number")) continue;
      this.lines.push({ tag, signal: name, unit });
      series[tag] = seriesOf(samples);
    }
    const times = Object.values(series).flatMap(({ t }) => [t[0], t.at(-1)]);
    this.window = { from: Math.min(...times, found.time_ms - 1000), to: Math.max(...times, found.time_ms) + 1000 };
    this.series = signal(series);
    this.markers = signal({ items: [tripOf(found)], isCut: false });
    this.resolution = signal("raw");
    this.state = signal("there");
    this.error = signal(null);
    this.fetched = this.window;
  }

  choose() {}

  want() {}

  listen() {}

  close() {}

  whole() {
    return this.series.peek();
  }
}

const tripOf = (found) => ({ id: found.id, time_ms: found.time_ms, kind: "fault", drive: found.drive, text: found.title ?? found.fault?.text, actor: null });

function seriesOf(samples) {
  const values = samples.map(([, value]) => (typeof value === "number" ? value : null));
  return { t: samples.map(([at]) => at), min: values, mean: values, max: values, q: samples.map(([, , quality]) => QUALITIES[quality]) };
}
