// The language of the page as Intl names it; English days come before months, and every day has 24 hours.

/** @param name "en" or "zh" */
export const localeOf = (name) => (name === "zh" ? "zh-CN" : "en-GB");
