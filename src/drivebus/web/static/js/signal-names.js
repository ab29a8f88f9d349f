// Names and order of signals.
import { signal } from "./lib.js";
import { hasKey, localized, t } from "./i18n.js";

/** The most used signals, in the order in which they are shown. */
const FIRST_SIGNALS = [
  "output_frequency", "output_current", "dc_bus_voltage", "output_voltage", "set_frequency",
];

/** To sort signals by that order; the others come after them. */
export const signalRank = (name) => (FIRST_SIGNALS.includes(name) ? FIRST_SIGNALS.indexOf(name) : FIRST_SIGNALS.length);

const profileSignalNames = signal({});

/** Add the names of a profile's signals: a list of {signal or name, text}. */
export function addSignalNames(list) {
  const news = list.filter((entry) => entry.text).map((entry) => [entry.signal ?? entry.name, entry.text]);
  profileSignalNames.value = { ...profileSignalNames.peek(), ...Object.fromEntries(news) };
}

/** Name of a signal in the reader's language: the catalogue's, else the profile's. */
export function signalName(name) {
  const key = `signal.${name}`;
  return hasKey(key) ? t(key) : localized(profileSignalNames.value[name]) || name.replaceAll("_", " ");
}
