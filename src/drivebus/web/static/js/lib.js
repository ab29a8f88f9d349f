// The vendored libraries under the names that the page uses. Nothing else imports ../../vendor, but for uPlot.
import { Component, h, render } from "../../vendor/preact.js";
import { useEffect, useId, useLayoutEffect, useMemo, useRef, useState } from "../../vendor/hooks.js";
import { batch, computed, effect, signal, useComputed, useSignalEffect } from "../../vendor/signals.js";
import htm from "../../vendor/htm.js";

export const html = htm.bind(h);
export {
  Component, batch, computed, effect, h, render, signal, useComputed, useEffect, useId, useLayoutEffect, useMemo, useRef,
  useSignalEffect, useState,
};

const nativeMove = Element.prototype.moveBefore;

/** Move a node as Preact does, with its style up to date: Chromium 156 drops the pending changes of style below a node that
 * moves, and a cleared alarm kept the colour of an active one. Text, which has no style of its own, moves as well. */
function moveBefore(node, next) {
  if (node instanceof Element) void getComputedStyle(node).color;
  nativeMove.call(this, node, next);
}
if (nativeMove) Element.prototype.moveBefore = moveBefore;
