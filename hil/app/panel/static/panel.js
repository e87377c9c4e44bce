// What the pages need beside their elements: the stop, and plots that grow point by point.
"use strict";

// -- stop: a finger, a mouse, a key or an aid to seeing; straight to the server, whatever else the page is doing -----------------
const HIL_ANSWER_MS = 1000;
let hilPresses = 0;
let hilLost = 0; // the latest press that was told as lost; 0 when none is

// A stop without an answer in time is told, but not taken back: when its answer does come, the page is as it was.
async function hilStop() {
  const press = ++hilPresses;
  const mark = document.querySelector("[data-name='stop']");
  mark?.classList.add("pressed");
  const late = setTimeout(() => hilTell(press, false), HIL_ANSWER_MS);
  try {
    const answer = await fetch("/stop", { method: "POST", keepalive: true });
    hilTell(press, answer.ok);
  } catch (_error) {
    hilTell(press, false);
  }
  clearTimeout(late);
  setTimeout(() => mark?.classList.remove("pressed"), 400);
}

// The answer to an earlier press says nothing of a later one.
function hilTell(press, arrived) {
  if (!arrived) hilLost = Math.max(hilLost, press);
  else if (press >= hilLost) hilLost = 0;
  const lost = document.querySelector("[data-name='stop-lost']");
  if (lost) lost.hidden = hilLost === 0;
}

let hilPointed = false;
document.addEventListener("pointerdown", (event) => {
  hilPointed = event.target.closest("[data-name='stop']") !== null;
  if (hilPointed) hilStop();
}, true);

// Enter on the button, or what reads the screen aloud: a click that no finger and no mouse began.
document.addEventListener("click", (event) => {
  if (event.target.closest("[data-name='stop']") && (event.detail === 0 || !hilPointed)) hilStop();
}, true);

// Where a space can be typed it is no stop: not in a field of numbers, nor in one that is only chosen from.
const HIL_TEXT = "input:is(:not([type]), [type='text'], [type='password'], [type='search']):not([readonly])";

document.addEventListener("keydown", (event) => {
  const typing = event.target.closest(`${HIL_TEXT}, textarea, [contenteditable='true']`);
  if (event.key === "Escape" || (event.key === " " && !typing)) {
    hilStop();
    if (event.key === " ") event.preventDefault();
  }
}, true);

// -- plots ---------------------------------------------------------------------------------------------------------------------
const hilPlots = new Map();

// Append points to the series of a chart. series: [[name, [[x, y], ...]], ...]; keep: points of each; anew: forget what was there;
// dots: points that are not joined, a triangle up in direction +, down in −.
function hilAppend(id, series, keep, anew, dots) {
  const chart = getElement(id)?.chart;
  if (!chart) return;
  const kept = anew ? new Map() : hilPlots.get(id) ?? new Map();
  for (const [name, points] of series) {
    const all = (kept.get(name) ?? []).concat(points);
    kept.set(name, all.length > keep ? all.slice(all.length - keep) : all);
  }
  hilPlots.set(id, kept);
  const line = { type: "line", showSymbol: false };
  const look = (name) => (dots ? { type: "scatter", symbol: "triangle", symbolSize: 9, symbolRotate: name.endsWith("−") ? 180 : 0 } : line);
  const drawn = [...kept].map(([name, data]) => ({ id: name, name, data, ...look(name), animation: false }));
  chart.setOption({ series: drawn }, anew ? { replaceMerge: ["series"] } : {});
}

// A chart that was made before its place on the page had a size takes the size on.
setInterval(() => {
  for (const box of document.querySelectorAll(".hil-plot")) {
    const chart = getElement(Number(box.id.slice(1)))?.chart;
    if (chart && box.clientWidth && chart.getWidth() !== box.clientWidth) chart.resize();
  }
}, 500);
