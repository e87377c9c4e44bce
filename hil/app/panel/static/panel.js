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

// Esc stops while anything moves, a job runs or waits, or the state is not known, whatever has the focus, and does nothing else then.
// Otherwise it closes what is on top. Space stops in the same states with the focus on STOP or on nothing; else it presses or types.
document.addEventListener("keydown", (event) => {
  if ((event.key !== "Escape" && event.key !== " ") || !hilBusy()) return;
  const free = event.target === document.body || event.target.closest("[data-name='stop']") !== null;
  if (event.key === " " && !free) return;
  event.preventDefault();
  event.stopImmediatePropagation(); // no dialog closes at the same press
  if (!event.repeat) hilStop();
}, true);

// The start of a job: Space and Enter stop without looking.
function hilFocusStop() {
  setTimeout(() => document.querySelector("[data-name='stop']")?.focus(), 300); // a dialog that closes gives the focus back first
}

// -- what is live: decided here, by the page's own timer, so that it holds without the server ---------------------------------------
const HIL_BEAT_LOST_MS = 700; // seven beats of the server; 1.2 s are allowed until it is seen
const HIL_SILENT_MS = 800; // sixteen samples of a drive
const HIL_BEATS = 50; // five seconds of them
let hilHeardAt = performance.now() + 1000; // when the last beat was sent, by the page's clock; of a page that has just come: time to connect
let hilBeats = []; // of the last beats: how much later they came than they were sent, by the two clocks, ms
let hilCut = false; // the connection was closed, as by a server that was killed
let hilAxes = {}; // by axis: seconds since drive and instrument were heard, null for not at all; lost: since; why; busy

// From the server, ten times a second. axes: {name: {drive, instrument, lost, why, busy}}; sentMs: when, by the server's clock. What counts is
// when a beat was sent, not when a busy page came to read it: the quickest of the last beats tells how the two clocks differ.
function hilBeat(axes, sentMs) {
  hilBeats = [...hilBeats, performance.now() - sentMs].slice(-HIL_BEATS);
  hilHeardAt = sentMs + Math.min(...hilBeats);
  hilCut = false;
  hilAxes = axes;
  hilMarkLost();
}

// A server that is killed closes the connection: that is told at once. Closed by a page that is left it tells nothing.
let hilListens = null, hilLeft = false;
addEventListener("pagehide", () => { hilLeft = true; });
addEventListener("pageshow", () => { hilLeft = false; });
function hilListen() {
  if (!window.socket || window.socket === hilListens) return;
  hilListens = window.socket;
  hilListens.on("disconnect", () => {
    if (hilLeft) return;
    hilCut = true;
    hilBeats = []; // another server has another clock
    hilMarkLost();
  });
}

function hilBusy() {
  if (hilServerLost() || Object.keys(hilAxes).length === 0) return true;
  return Object.entries(hilAxes).some(([name, axis]) => axis.busy || hilSilentMs(name, "drive") > HIL_SILENT_MS);
}

function hilServerLost() {
  return hilCut || performance.now() - hilHeardAt > HIL_BEAT_LOST_MS;
}

// Time since a source was heard, ms; that of the server where that is the one that is silent.
function hilSilentMs(name, source) {
  const since = Math.max(0, performance.now() - hilHeardAt);
  if (source === "server" || hilServerLost()) return since;
  const seconds = hilAxes[name]?.[source];
  if (seconds === undefined) return since;
  return seconds === null ? Infinity : since + 1000 * seconds;
}

const hilLostSince = new Map(); // "axis.source" -> time of day, ms

// Whether a source is gone; its first moment is kept for the banner: it is the server's, so that another page tells the same.
function hilGone(name, source) {
  const ms = hilSilentMs(name, source), key = `${name}.${source}`;
  const gone = hilServerLost() || (source !== "server" && ms > HIL_SILENT_MS);
  if (!gone) hilLostSince.delete(key);
  else if (!hilLostSince.has(key)) {
    const lost = hilServerLost() ? undefined : hilAxes[name]?.lost?.[source];
    hilLostSince.set(key, Date.now() - (lost === undefined ? ms : 1000 * lost));
  }
  return gone;
}

function hilMarkLost() {
  for (const one of document.querySelectorAll("[data-live]")) {
    const cut = one.dataset.live.lastIndexOf(".");
    one.classList.toggle("hil-stale", hilGone(one.dataset.live.slice(0, cut), one.dataset.live.slice(cut + 1)));
  }
  hilTellLost();
}

// The banner says which source is gone, why, and since when; of several the one that the others depend on.
function hilTellLost() {
  const banner = document.querySelector("[data-name='no-data']");
  if (!banner) return;
  const name = banner.dataset.axis;
  const told = (source) => source !== "instrument" || hilAxes[name]?.why?.instrument !== "unused";
  const gone = ["instrument", "drive", "server"].filter((source) => hilGone(name, source) && told(source)).pop();
  banner.hidden = gone === undefined;
  document.body.classList.toggle("hil-no-server", gone === "server");
  if (gone === undefined) return;
  const why = (gone !== "server" && hilAxes[name]?.why?.[gone]) || gone;
  for (const one of banner.querySelectorAll("[data-why]")) one.hidden = one.dataset.why !== why;
  const begun = new Date(hilLostSince.get(`${name}.${gone}`));
  const clock = [begun.getHours(), begun.getMinutes(), begun.getSeconds()].map((one) => String(one).padStart(2, "0")).join(":");
  const seconds = Math.max(0, Math.round((Date.now() - begun.getTime()) / 1000));
  const since = banner.querySelector("[data-name='no-data.since']");
  if (since) since.textContent = since.dataset.text.replace("{time}", clock).replace("{seconds}", String(seconds));
}

setInterval(() => {
  hilListen();
  hilMarkLost();
}, 50);

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
  chart.setOption({ series: drawn, title: { show: drawn.length === 0 } }, anew ? { replaceMerge: ["series"] } : {});
}

// A line through a chart at a place of its x axis; null takes it away.
function hilMarkX(id, x, text) {
  const chart = getElement(id)?.chart;
  const first = chart?.getOption().series?.[0];
  if (!first) return;
  const ink = getComputedStyle(document.body).color;
  const label = { show: true, formatter: text, position: "end", color: ink, textBorderWidth: 0 };
  const data = x === null ? [] : [{ xAxis: x, label }];
  chart.setOption({ series: [{ id: first.id, markLine: { symbol: "none", silent: true, lineStyle: { type: "dashed", width: 2 }, data } }] });
}

// Live charts: rows of [time, mark, values ...]. What is drawn is so many seconds ago by the page's own clock, so that a gap is seen.
const hilLives = new Map();
const HIL_MOST_TARGETS = 30; // more of them, as of small steps, would hide the curve
const HIL_MARKS = { target: "▾", stop: "■", fault: "!" };

function hilLive(id, rows, keep, anew) {
  const live = anew || !hilLives.has(id) ? { rows: [], paused: hilLives.get(id)?.paused ?? false } : hilLives.get(id);
  live.rows = live.rows.concat(rows).slice(-keep);
  live.last = live.rows.at(-1)?.[0] ?? 0;
  live.at = performance.now();
  hilLives.set(id, live);
  hilDrawLive(id, live);
}

function hilDrawLive(id, live) {
  const chart = getElement(id)?.chart;
  if (!chart || live.paused) return;
  const now = live.last + (performance.now() - live.at) / 1000;
  const count = chart.getOption().series.length;
  const ink = getComputedStyle(document.body).color;
  const reached = live.rows.filter((row) => row[1] === "target").length;
  const marks = live.rows.filter((row) => row[1] && (row[1] !== "target" || reached <= HIL_MOST_TARGETS)).map((row) => ({
    xAxis: row[0] - now,
    lineStyle: row[1] === "target" ? { opacity: 0.3, color: ink } : { width: 2 },
    label: { show: true, position: "start", formatter: HIL_MARKS[row[1]], color: ink, textBorderWidth: 0 },
  }));
  const series = [];
  for (let index = 0; index < count; index += 1) {
    const old = chart.getOption().series[index];
    const limits = (old.markLine?.data ?? []).filter((line) => line.yAxis !== undefined);
    const drawn = index === 0 ? marks : [];
    series.push({ id: old.id, data: live.rows.map((row) => [row[0] - now, row[2 + index]]), markLine: { ...old.markLine, symbol: "none", data: [...limits, ...drawn] } });
  }
  chart.setOption({ series });
}

function hilPause(id, held) {
  const live = hilLives.get(id);
  if (live) live.paused = held;
}

setInterval(() => {
  for (const [id, live] of hilLives) {
    if (!getElement(id)) hilLives.delete(id);
    else if (performance.now() - live.at > 400) hilDrawLive(id, live); // nothing came: it goes on moving
  }
}, 200);

// -- keys beside the stop: F1 how it is done, F2 events, Alt+1 … 9 pages; Esc closes the drawer where it does not stop -------------------
document.addEventListener("keydown", (event) => {
  const press = (name) => document.querySelector(`[data-name='${name}']`)?.click();
  if (event.key === "F1") document.querySelector('[data-how] .q-item')?.click();
  else if (event.key === "F2") press("events.open");
  else if (event.altKey && /^[1-9]$/.test(event.key)) document.querySelectorAll("[data-name='navigation'] a")[Number(event.key) - 1]?.click();
  else if (event.key === "Escape" && document.querySelector("[data-name='events']")?.checkVisibility()) press("events.close");
  else return;
  event.preventDefault();
});

// Whether this computer has a font with Chinese: the sign of one is a single stroke there. What is drawn for a missing sign is as high as
// for any other, or nothing.
function hilDrawsChinese() {
  const pen = document.createElement("canvas").getContext("2d");
  pen.font = `40px ${getComputedStyle(document.body).fontFamily}`;
  const height = (sign) => pen.measureText(sign).actualBoundingBoxAscent + pen.measureText(sign).actualBoundingBoxDescent;
  return height("\u4e00") > 0 && 2 * height("\u4e00") < height("\u4e2d");
}

// A chart draws its words once: it is drawn anew when the fonts of the page have come.
document.fonts?.ready.then(async () => {
  await Promise.all(["14px Roboto", "14px 'Hil Signs'"].map((font) => document.fonts.load(font, "A→■")));
  for (const box of document.querySelectorAll(".hil-plot")) getElement(Number(box.id.slice(1)))?.chart?.resize();
});

// A chart that was made before its place on the page had a size takes the size on.
setInterval(() => {
  for (const box of document.querySelectorAll(".hil-plot")) {
    const chart = getElement(Number(box.id.slice(1)))?.chart;
    if (chart && box.clientWidth && (chart.getWidth() !== box.clientWidth || chart.getHeight() !== box.clientHeight)) chart.resize();
  }
}, 500);
