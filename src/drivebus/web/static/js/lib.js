// The vendored libraries under the names that the page uses. Nothing else imports ../../vendor, but for uPlot.
import { Component, Fragment, h, render } from "../../vendor/preact.js";
import { useCallback, useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "../../vendor/hooks.js";
import {
  batch, computed, effect, signal, untracked, useComputed, useSignal, useSignalEffect,
} from "../../vendor/signals.js";
import htm from "../../vendor/htm.js";

export const html = htm.bind(h);
export {
  Component, Fragment, batch, computed, effect, h, render, signal, untracked, useCallback, useComputed, useEffect,
  useId, useLayoutEffect, useMemo, useRef, useSignal, useSignalEffect, useState,
};
