// Preferences of the user stored in this browser; no secrets. Works without storage too.
const PREFIX = "drivebus.";

export function loadPreference(name, otherwise = null) {
  try {
    const found = localStorage.getItem(PREFIX + name);
    return found === null ? otherwise : JSON.parse(found);
  } catch {
    return otherwise;
  }
}

/** Call `act` with the value of a preference that another tab of this browser has changed. */
export function onPreferenceOfOtherTab(name, act) {
  addEventListener("storage", ({ key }) => { if (key === PREFIX + name) act(loadPreference(name)); });
}

export function savePreference(name, value) {
  try {
    localStorage.setItem(PREFIX + name, JSON.stringify(value));
  } catch {
    // Without storage the choice lasts as long as the page.
  }
}
