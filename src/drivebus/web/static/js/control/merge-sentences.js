// Equal sentences about several drives as one: the drives are named together, measured values become a range.
import { localized, placeOf, replaced, t } from "../i18n.js";
import { drive } from "../store.js";
import { busTitle, listDrives, shortList } from "../titles.js";

/** Parameters of a sentence that name the drive. */
const DRIVE_PARAMETERS = ["drive", "station", "address"];
/** Measured values: of several drives the lowest and the highest are shown. */
const MEASURED_PARAMETERS = ["error_percent"];
/** All other parameters must be equal for sentences to be one. */
const MERGED_PARAMETERS = [...DRIVE_PARAMETERS, ...MEASURED_PARAMETERS];

/** Equal sentences of several drives as one: `items` are {id, key, params, text}; the result is [{ids, names, text, isNamed}],
 * and `isNamed` says that the text has the names of the drives. Of `total` drives all have no names but their number. */
export function mergeSentences(items, total = null) {
  const groups = new Map();
  for (const item of items) {
    const others = Object.entries(item.params ?? {}).filter(([name]) => !MERGED_PARAMETERS.includes(name));
    const alike = JSON.stringify([item.key, others]);
    groups.set(alike, [...(groups.get(alike) ?? []), item]);
  }
  return [...groups.values()].map((alike) => {
    const ids = [...new Set(alike.map(({ id }) => id))];
    const names = ids.length > 1 && ids.length === total ? t("page.all_drives", { n: total }) : listDrives(ids);
    return { ids, names, ...mergedText(alike, names) };
  });
}

function mergedText(alike, names) {
  const [{ key, params }] = alike;
  const text = MEASURED_PARAMETERS.reduce((sentence, name) => withRange(sentence, alike, name), localized(alike[0].text));
  const found = DRIVE_PARAMETERS.find((name) => params?.[name] !== undefined && placeOf(text, String(params[name])) >= 0);
  if (!found || (alike.length === 1 && found !== "drive")) return { text, isNamed: false };
  const isNamed = found === "drive";
  const own = isNamed ? names : listStations(alike, found);
  // A parameter that the service writes in a way of its own, such as a list, is only in its text.
  const isOfCatalogue = t(key, params) === text;
  return { text: isOfCatalogue ? t(key, { ...params, [found]: own }) : replaced(text, String(params[found]), own), isNamed };
}

/** Stations of drives with the name of their bus: "1 to 30 (Line 1), 4 (Line 2)". `name` is the parameter with the station. */
function listStations(alike, name) {
  const buses = new Map();
  for (const { id, params } of alike) {
    const title = drive(id).value ? busTitle(drive(id).value.bus) : "";
    buses.set(title, (buses.get(title) ?? new Set()).add(params[name]));
  }
  const texts = [...buses].map(([title, found]) => {
    const stations = listRuns(runsOf([...found]));
    return title ? t("page.stations_of_bus", { stations, bus: title }) : stations;
  });
  return shortList(texts, undefined, [...buses.values()].map(({ size }) => size));
}

/** Numbers as runs of consecutive ones. */
function runsOf(stations) {
  const runs = [];
  for (const station of stations.sort((one, other) => one - other)) {
    if (runs.at(-1)?.at(-1) === station - 1) runs.at(-1).push(station);
    else runs.push([station]);
  }
  return runs.flatMap((run) => (run.length > 2 ? [run] : run.map((station) => [station])));
}

const listRuns = (runs) => shortList(runs.map((run) => (run.length > 1
  ? t("page.value_range", { least: run[0], most: run.at(-1) }) : String(run[0]))), undefined, runs.map(({ length }) => length));

/** The sentence of the first drive with the lowest and the highest of the measured values. */
function withRange(sentence, alike, name) {
  const values = alike.map(({ params }) => params?.[name]);
  const [least, most] = [Math.min(...values), Math.max(...values)].map(decimal);
  return least === most ? sentence : replaced(sentence, decimal(values[0]), t("page.value_range", { least, most }));
}

/** A measured value as the service writes it: "3.0", "3.12". */
const decimal = (value) => (Number.isInteger(value) ? value.toFixed(1) : String(value));
