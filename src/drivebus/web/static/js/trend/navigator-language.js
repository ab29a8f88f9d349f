// Valid language of the browser for uPlot, which formats numbers by it as it is loaded: WebKit on a machine with the locale
// "C", as some panel computers have, names its language "C", and no chart could be loaded.
try {
  Intl.getCanonicalLocales(navigator.language);
} catch {
  Object.defineProperty(navigator, "language", { value: "en" });
}
