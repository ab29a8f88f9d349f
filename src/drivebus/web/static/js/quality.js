// Quality of a sample as the historian codes it.

export const GOOD = 0;
export const UNCERTAIN = 1;
export const BAD = 2;

/** Code of each quality of a live value. */
export const QUALITIES = { good: GOOD, uncertain: UNCERTAIN, bad: BAD };
