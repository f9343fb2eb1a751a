"use strict";
// Draws every chart of the page; drag zooms in time, a double click shows everything.
const COLOURS = ["#1f5fa8", "#c4511d", "#2a8050", "#8a3d9c", "#8f7a00", "#3f8c99", "#7a4a2b"];
const NAMED = { truth: "#202020", prior: "#9a9a9a" }; // lines of one meaning on every chart
const HEIGHT = 240;

function spread(data) {
  // Lines and their bands as series of uPlot: each band is two series without a stroke.
  const across = data.x_label.startsWith("time") ? "t [s]" : data.x_label;
  const columns = [data.x], series = [{ label: across, value: (_, v) => number(v) }], bands = [];
  let unnamed = 0;
  data.lines.forEach((line, k) => {
    const colour = NAMED[line.label] ?? COLOURS[unnamed++ % COLOURS.length];
    const bars = data.bars && k === 0;
    columns.push(line.y);
    series.push({
      label: line.label,
      stroke: colour,
      width: line.points ? 0 : 1.5,
      fill: bars ? colour + "55" : undefined,
      paths: bars ? uPlot.paths.bars({ size: [0.95, 100] }) : line.points ? () => null : undefined,
      points: { show: line.points, size: 8, fill: colour },
      value: (_, v) => number(v),
    });
    if (line.low && line.high) {
      for (const edge of [line.high, line.low]) {
        columns.push(edge);
        series.push({ label: "", stroke: undefined, width: 0, points: { show: false }, class: "edge" });
      }
      bands.push({ series: [columns.length - 2, columns.length - 1], fill: colour + "26" });
    }
  });
  return { columns, series, bands };
}

function number(v) {
  return v == null ? "" : Number(v.toPrecision(5)).toString();
}

function decades(u, axis, low, high) {
  // At most eight powers of ten: the library's own ticks overflow where values are very small.
  const first = Math.ceil(Math.log10(low) - 1e-9), last = Math.floor(Math.log10(high) + 1e-9);
  const step = Math.max(1, Math.ceil((last - first + 1) / 8));
  const ticks = [];
  for (let power = first; power <= last; power += step) ticks.push(10 ** power);
  return ticks;
}

function width(figure) {
  return Math.max(figure.clientWidth, 100); // none while it is folded
}

function draw(figure, data) {
  const { columns, series, bands } = spread(data);
  const isTime = data.x_label.startsWith("time");
  let narrow = data.y_range !== null;
  const options = {
    width: width(figure),
    height: HEIGHT,
    series,
    bands,
    legend: { live: true },
    cursor: isTime ? { sync: { key: "time", scales: ["x", null] } } : {},
    hooks: { setSelect: [(u) => { narrow = narrow && u.select.width === 0; }] },
    scales: {
      x: { time: false },
      y: {
        distr: data.log ? 3 : 1,
        range: data.log
          ? undefined
          : (u, low, high) => {
              if (narrow) return data.y_range;
              return uPlot.rangeNum(low ?? 0, high ?? 1, 0.08, true);
            },
      },
    },
    axes: [
      { label: data.x_label, size: 44, labelSize: 22 },
      {
        label: data.y_label,
        labelSize: 22,
        size: (u, values) => 26 + 8.5 * Math.max(3, ...(values ?? []).map((v) => (v ?? "").length)),
        values: data.levels.length
          ? (u, ticks) => ticks.map((tick) => data.levels[tick] ?? "")
          : (u, ticks) => ticks.map((tick) => (tick == null ? "" : number(tick))),
        splits: data.levels.length ? () => data.levels.map((_, k) => k) : data.log ? decades : undefined,
        filter: (u, ticks) => ticks,
      },
    ],
  };
  const plot = new uPlot(options, columns, figure);
  figure.querySelectorAll(".u-legend .edge").forEach((row) => row.remove());
  plot.over.addEventListener("dblclick", () => {
    narrow = false;
  }, true);
  const fit = () => plot.setSize({ width: width(figure), height: HEIGHT });
  new ResizeObserver(fit).observe(figure);
  window.addEventListener("beforeprint", fit);
  return plot;
}

window.addEventListener("beforeprint", () => {
  document.querySelectorAll("details.fold").forEach((fold) => { fold.open = true; });
});
const charts = JSON.parse(document.getElementById("charts").textContent);
window.plots = [...document.querySelectorAll("figure[data-chart]")].map((figure) =>
  draw(figure, charts[Number(figure.dataset.chart)]),
);
document.body.dataset.drawn = String(charts.length);
