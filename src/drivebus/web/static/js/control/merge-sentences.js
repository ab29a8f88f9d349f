// Equal sentences about several drives as one: the drives are named together, measured values become a range.
import { localized, replaced, t } from "../i18n.js";
import { listDrives, shortList } from "../titles.js";

/** Parameters of a sentence that name the drive. */
const DRIVE_PARAMETERS = ["drive", "station", "address"];
/** Measured values: of several drives the lowest and the highest are shown. */
const MEASURED_PARAMETERS = ["error_percent"];
/** All other parameters must be equal for sentences to be one. */
const MERGED_PARAMETERS = [...DRIVE_PARAMETERS, ...MEASURED_PARAMETERS];

/** Equal sentences of several drives as one: `items` are {id, key, params, text}; the result is [{ids, text, isNamed}], and
 * `isNamed` says that the text has the names of the drives. */
export function mergeSentences(items) {
  const groups = new Map();
  for (const one of items) {
    const others = Object.entries(one.params ?? {}).filter(([name]) => !MERGED_PARAMETERS.includes(name));
    const alike = JSON.stringify([one.key, others]);
    groups.set(alike, [...(groups.get(alike) ?? []), one]);
  }
  return [...groups.values()].map((alike) => ({ ids: alike.map(({ id }) => id), ...mergedText(alike) }));
}

function mergedText(alike) {
  const [{ params }] = alike;
  const text = MEASURED_PARAMETERS.reduce((sentence, name) => withRange(sentence, alike, name), localized(alike[0].text));
  const found = DRIVE_PARAMETERS.find((name) => params?.[name] !== undefined && text.includes(String(params[name])));
  if (!found) return { text, isNamed: false };
  const isNamed = found === "drive";
  const own = isNamed ? listDrives(alike.map(({ id }) => id)) : shortList([...new Set(alike.map((one) => one.params[found]))]);
  return { text: replaced(text, String(params[found]), own), isNamed };
}

/** The sentence of the first drive with the lowest and the highest of the measured values. */
function withRange(sentence, alike, name) {
  const values = alike.map(({ params }) => params?.[name]);
  const [least, most] = [Math.min(...values), Math.max(...values)].map(decimal);
  return least === most ? sentence : replaced(sentence, decimal(values[0]), t("page.value_range", { least, most }));
}

/** A measured value as the service writes it: "3.0", "3.12". */
const decimal = (value) => (Number.isInteger(value) ? value.toFixed(1) : String(value));
