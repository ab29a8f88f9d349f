// The vendored libraries under the names that the page uses. Nothing else imports ../../vendor, but for uPlot.
import { h, render } from "../../vendor/preact.js";
import { useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "../../vendor/hooks.js";
import { batch, computed, effect, signal, useComputed, useSignalEffect } from "../../vendor/signals.js";
import htm from "../../vendor/htm.js";

export const html = htm.bind(h);
export {
  batch, computed, effect, h, render, signal, useComputed, useEffect, useId, useLayoutEffect, useMemo, useRef,
  useSignalEffect, useState,
};
