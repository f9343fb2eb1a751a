// Time plots on a canvas: lines with a band of one sigma; where nothing came, nothing is drawn.
const SPAN_MS = 300000;
const GAP_INTERVALS = 3, LEAST_GAP_MS = 2000;

class Plot {
  // series: [{ colour, rows: [[t, value, low, high]] }]
  constructor(canvas) {
    this.canvas = canvas;
    this.series = [];
    this.empty = 'no values yet';
  }

  draw(now) {
    const { canvas } = this, scale = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    canvas.width = width * scale;
    canvas.height = height * scale;
    const pen = canvas.getContext('2d');
    pen.scale(scale, scale);
    pen.font = '12px system-ui';
    const series = this.series.map((one) => ({ ...one, rows: one.rows.filter(([t]) => t > now - SPAN_MS) }));
    const all = series.flatMap((one) => one.rows);
    if (!all.length) {
      pen.fillStyle = '#93a0ad';
      pen.fillText(this.empty, 8, height / 2);
      return;
    }
    const [low, high] = Plot.range(all);
    const first = Math.max(now - SPAN_MS, Math.min(...all.map(([t]) => t)));
    const left = 58, x = (t) => left + ((t - first) / Math.max(now - first, 1000)) * (width - left - 4);
    const y = (v) => height - 20 - ((v - low) / (high - low)) * (height - 28);
    this.axes(pen, { low, high, first, now, x, y, width, height, left });
    pen.save();
    pen.beginPath();
    pen.rect(left, 0, width - left, height - 18);
    pen.clip();
    for (const one of series)
      for (const part of Plot.parts(one.rows)) Plot.line(pen, part, one.colour, x, y);
    pen.restore();
  }

  // The range that shows the band as it is now: of the newer half of the time only.
  static range(rows) {
    const times = rows.map(([t]) => t), middle = (Math.min(...times) + Math.max(...times)) / 2;
    const newer = rows.filter(([t]) => t >= middle);
    const low = Math.min(...newer.map(([, v, l]) => l ?? v)), high = Math.max(...newer.map(([, v, , h]) => h ?? v));
    const room = Math.max(0.15 * (high - low), 1e-6 * Math.abs(high), 1e-12);
    return [low - room, high + room];
  }

  // Rows between gaps.
  static parts(rows) {
    const steps = rows.slice(1).map(([t], k) => t - rows[k][0]).sort((a, b) => a - b);
    const gap = Math.max(LEAST_GAP_MS, GAP_INTERVALS * (steps[steps.length >> 1] ?? 0));
    const parts = [];
    rows.forEach((row, k) => {
      if (k === 0 || row[0] - rows[k - 1][0] > gap) parts.push([]);
      parts.at(-1).push(row);
    });
    return parts;
  }

  static line(pen, part, colour, x, y) {
    if (part[0].length > 2) {
      pen.beginPath();
      part.forEach(([t, , , high]) => pen.lineTo(x(t), y(high)));
      [...part].reverse().forEach(([t, , low]) => pen.lineTo(x(t), y(low)));
      pen.fillStyle = `${colour}44`;
      pen.fill();
    }
    pen.beginPath();
    part.forEach(([t, v]) => pen.lineTo(x(t), y(v)));
    if (part.length === 1) pen.arc(x(part[0][0]), y(part[0][1]), 1.5, 0, 7);
    pen.strokeStyle = colour;
    pen.lineWidth = 1.6;
    pen.stroke();
  }

  axes(pen, { low, high, first, now, x, y, width, height, left }) {
    pen.strokeStyle = '#333c46';
    pen.fillStyle = '#93a0ad';
    const digits = Math.max(0, Math.min(6, 1 - Math.floor(Math.log10(high - low))));
    for (let k = 0; k <= 3; k++) {
      const v = low + (k / 3) * (high - low);
      pen.beginPath();
      pen.moveTo(left, y(v));
      pen.lineTo(width, y(v));
      pen.stroke();
      pen.fillText(v.toFixed(digits), 2, Math.max(10, y(v) + 4));
    }
    const clock = (t) => new Date(t).toISOString().slice(11, 19);
    pen.fillText(clock(first), left, height - 4);
    if (width > 300) pen.fillText(`${clock(now)} UTC`, width - 84, height - 4);
  }
}
