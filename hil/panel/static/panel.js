// What the pages need beside their elements: the stop, and plots that grow point by point.
"use strict";

// -- stop: a finger, a mouse, Esc or the space bar; straight to the server, whatever else the page is doing ---------------------
async function hilStop() {
  const mark = document.querySelector("[data-name='stop']");
  if (mark) mark.classList.add("pressed");
  try {
    const answer = await fetch("/stop", { method: "POST", keepalive: true });
    if (!answer.ok) throw new Error(String(answer.status));
  } catch (_error) {
    const lost = document.querySelector("[data-name='stop-lost']");
    if (lost) lost.hidden = false;
  }
  if (mark) setTimeout(() => mark.classList.remove("pressed"), 400);
}

document.addEventListener("pointerdown", (event) => {
  if (event.target.closest("[data-name='stop']")) hilStop();
}, true);

document.addEventListener("keydown", (event) => {
  const typing = event.target.closest("input, textarea, [contenteditable='true']");
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
