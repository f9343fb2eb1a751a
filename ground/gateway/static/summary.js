// The overview: a verdict, the values an operator looks at first, plots, events.
const BODIES = { target: '#4d9de0', base: '#58b368' };
const JOINT_COLOURS = ['#4d9de0', '#58b368', '#e08a2e', '#e0463e', '#a880d8', '#c7b53a', '#5cc8c0', '#93a0ad'];
const JOINTS = JOINT_COLOURS.map((_, k) => `estimate.residual_torque_${k + 1}_ratio`);
const POINTS = [
  'health.mode', 'health.health', 'health.health_now', 'health.slips', 'health.max_late_us', 'health.summary_age_s',
  'health.tc_rejected', 'estimate.valid', 'estimate.reason', 'estimate.blocks', 'estimate.nis', 'estimate.nis_dof',
  'recorder.recording', 'recorder.disk_free_bytes', 'link.tm_dropped', ...JOINTS,
  ...Object.keys(BODIES).flatMap((body) => ['present', 'mass_kg', 'mass_kg_low', 'mass_kg_high', 'sigma_mass_kg',
    'com_x_m', 'com_y_m', 'com_z_m'].map((field) => `estimate.${body}_${field}`))
];
const KEPT_MS = 600000, BURST_MS = 60000, SHOWN_EVENTS = 60;

const rows = new Map(POINTS.map((key) => [key, []]));
const now = (key) => rows.get(key).at(-1)?.[1];
let words, events = [], stale = new Set(), link = { connected: false, reason: 'starting' }, unknown = 0;

const label = (key) => words.labels[key]?.[now(key)] ?? '';
const bitsOf = (word) => Object.entries(words.bits).filter(([bit]) => Math.floor(word / 2 ** bit) % 2).map(([, found]) => found);
const ofSeverity = (bits, wanted) => bits.filter(([severity]) => severity === wanted);
const namesOf = (bits) => bits.map(([, name]) => name).join(', ');
const clock = (ms) => new Date(ms).toISOString().slice(11, 19);
const isStale = (packet) => !link.connected || stale.has(packet);

function addRows(key, found) {
  const kept = rows.get(key);
  for (const row of found) if (!kept.length || row[0] > kept.at(-1)[0]) kept.push(row);
  while (kept.length && kept[0][0] < Date.now() - KEPT_MS) kept.shift();
}

function verdict() {
  if (!link.connected) return ['high', 'NO TELEMETRY', link.reason];
  if (now('health.mode') === undefined) return ['low', 'WAITING', 'no health packet yet'];
  if (isStale('health')) return ['high', 'STALE', 'health is overdue: values are old'];
  const faults = bitsOf(now('health.health_now')), latched = bitsOf(now('health.health'));
  if (ofSeverity(faults, 'high').length) return ['high', `${validity()}, FAULT`, namesOf(faults)];
  if (ofSeverity(faults, 'medium').length) return ['medium', `${validity()}, DEGRADED`, namesOf(faults)];
  if (isStale('estimate')) return ['medium', 'ESTIMATE STALE', 'the estimate is overdue'];
  if (label('health.mode') !== 'IDENTIFY' && label('health.mode') !== 'BATCH')
    return ['low', label('health.mode'), 'nothing is identified in this mode'];
  if (!now('estimate.valid')) return ['low', 'NOT VALID YET', wordsOf(label('estimate.reason'))];
  const past = latched.filter(([severity]) => severity !== 'low');
  if (past.length) return ['low', 'VALID, WITH A PAST FAULT', `over, and kept until cleared: ${namesOf(past)}`];
  return ['good', 'VALID', latched.length ? `nothing to do; noted: ${namesOf(latched)}` : 'healthy: no fault now or before'];
}
const validity = () => isStale('estimate') ? 'ESTIMATE STALE' : now('estimate.valid') ? 'VALID' : 'NOT VALID';
const wordsOf = (text) => text.toLowerCase().replaceAll('_', ' ');

function tile(name, value, more, colour, packet) {
  const item = document.createElement('div');
  item.className = `tile ${colour} ${packet && isStale(packet) ? 'stale' : ''}`;
  for (const [kind, text] of [['span', name], ['b', value], ['span', more]]) {
    const part = document.createElement(kind);
    part.textContent = text;
    item.append(part);
  }
  return item;
}

function bodyTile(body) {
  const title = body[0].toUpperCase() + body.slice(1), value = (field) => now(`estimate.${body}_${field}`);
  if (value('present') === undefined) return tile(title, '...', 'no estimate yet', '', 'estimate');
  if (!value('present')) return tile(title, 'not identified', 'taken as known, or absent', '', 'estimate');
  const digits = Math.max(0, Math.min(4, 1 - Math.floor(Math.log10(value('sigma_mass_kg') || 1))));
  const com = ['x', 'y', 'z'].map((axis) => value(`com_${axis}_m`).toFixed(3)).join(', ');
  return tile(title, `${value('mass_kg').toFixed(digits)} ± ${value('sigma_mass_kg').toFixed(digits)} kg`,
    `${now('estimate.valid') ? 'valid' : 'not valid'}, centre of mass ${com} m`, now('estimate.valid') ? 'good' : 'low', 'estimate');
}

function healthTile(name, key, none, colour, more) {
  if (now(key) === undefined) return tile(name, '...', '', '', 'health');
  const found = bitsOf(now(key)), worst = ['high', 'medium', 'low'].find((one) => ofSeverity(found, one).length);
  const shown = worst === 'medium' ? colour : worst ?? 'good';
  return tile(name, namesOf(found) || none, found.length ? more : '', shown, 'health');
}

function tiles() {
  const slips = now('health.slips'), recording = now('recorder.recording'), dropped = now('link.tm_dropped');
  const free = now('recorder.disk_free_bytes');
  return [
    bodyTile('target'), bodyTile('base'),
    healthTile('Faults now', 'health.health_now', 'none', 'medium', 'the events below say which'),
    healthTile('Faults so far', 'health.health', 'none', 'low', 'kept until a command clears them'),
    tile('Slips', slips ?? '...', `latest wake ${(now('health.max_late_us') ?? 0).toFixed(0)} us`, slips ? 'low' : 'good', 'health'),
    tile('Recording', recording === undefined ? '...' : recording ? 'yes' : 'NO',
      free ? `${(free / 1e9).toFixed(1)} GB free` : '', recording === 0 ? 'medium' : recording ? 'good' : '', 'recorder'),
    tile('Mode', label('health.mode') || '...', `${now('estimate.blocks') ?? 0} windows used`, 'info', 'health'),
    tile('Link', link.connected ? 'connected' : 'lost', `${dropped ?? 0} dropped, ${unknown} unknown packets`,
      link.connected ? (dropped || unknown ? 'low' : 'good') : 'high')
  ];
}

// One line per burst: events of one code that follow each other within a minute.
function bursts() {
  const found = [], open = new Map();
  for (const event of events) {
    const last = open.get(event.code);
    if (last && event.utc - last.last < BURST_MS) {
      Object.assign(last, { count: last.count + 1, last: event.utc, text: event.text });
    } else {
      const burst = { ...event, count: 1, first: event.utc, last: event.utc };
      open.set(event.code, burst);
      found.push(burst);
    }
  }
  return found.sort((a, b) => b.last - a.last).slice(0, SHOWN_EVENTS);
}

function eventLines() {
  return bursts().map(({ severity, code, text, count, first, last }) => {
    const line = document.createElement('div'), name = document.createElement('b');
    line.className = `event ${severity}`;
    name.textContent = `${code}${count > 1 ? ` × ${count}` : ''}`;
    const when = count > 1 && last - first > 1000 ? `${clock(first)} to ${clock(last)}` : clock(last);
    line.append(`${when}  `, name, `  ${text}`);
    return line;
  });
}

const plots = Object.fromEntries(['target', 'base', 'nis', 'residual'].map((name) =>
  [name, new Plot(document.getElementById(`plot-${name}`))]));

function named(k, colour) {
  const name = document.createElement('span');
  name.textContent = `joint ${k + 1} `;
  name.style.color = colour;
  return name;
}

function plotBody(body) {
  const at = (field) => new Map(rows.get(`estimate.${body}_${field}`));
  const low = at('mass_kg_low'), high = at('mass_kg_high'), present = at('present');
  plots[body].canvas.parentElement.hidden = now(`estimate.${body}_present`) === 0;
  plots[body].series = [{ colour: BODIES[body], rows: rows.get(`estimate.${body}_mass_kg`)
    .filter(([t]) => present.get(t) && low.has(t) && high.has(t)).map(([t, v]) => [t, v, low.get(t), high.get(t)]) }];
}

function draw() {
  const [colour, text, why] = verdict(), head = document.getElementById('verdict');
  head.className = colour;
  head.children[0].textContent = text;
  head.children[1].textContent = why;
  document.title = `${text} - inertia daemon`;
  document.getElementById('tiles').replaceChildren(...tiles());
  document.getElementById('events').replaceChildren(...eventLines());
  Object.keys(BODIES).forEach(plotBody);
  const dof = new Map(rows.get('estimate.nis_dof'));
  plots.nis.series = [{ colour: '#4d9de0', rows: rows.get('estimate.nis').filter(([t]) => dof.get(t)).map(([t, v]) => [t, v / dof.get(t)]) }];
  plots.residual.series = JOINTS.map((key, k) => ({ colour: JOINT_COLOURS[k], rows: rows.get(key).filter(([, v]) => v > 0) }));
  document.getElementById('legend-residual').replaceChildren(...plots.residual.series.flatMap((one, k) => one.rows.length ? [named(k, one.colour)] : []));
  Object.values(plots).forEach((plot) => plot.draw(Date.now()));
}

// What came while the history was asked for is in it, or follows it: nothing is missed or shown twice.
function connect() {
  const socket = new WebSocket(`${location.origin.replace('http', 'ws')}/stream`);
  let held = [];
  socket.onopen = async () => {
    socket.send(JSON.stringify({ subscribe: POINTS }));
    try {
      await load();
    } catch {
      socket.close();
      return;
    }
    const known = new Set(events.map(identity));
    for (const message of held)
      take({ ...message, events: message.events.filter((event) => !known.has(identity(event))) });
    held = null;
  };
  socket.onclose = () => {
    link = { connected: false, reason: 'no gateway' };
    setTimeout(connect, 1000);
  };
  socket.onmessage = ({ data }) => {
    const message = JSON.parse(data);
    if (held) held.push(message);
    else take(message);
  };
}

const identity = ({ utc, code, text }) => `${utc} ${code} ${text}`;

function take(message) {
  if (message.stale) {
    stale = new Set(message.stale);
    link = message.link;
    unknown = message.unknown;
  }
  for (const [key, found] of Object.entries(message.points)) addRows(key, found);
  events = [...events, ...message.events].slice(-2000);
}

async function load() {
  const query = new URLSearchParams({ start: Date.now() - KEPT_MS, end: Date.now() + 60000, size: 600 });
  events = await (await fetch(`history/events?${query}`)).json();
  await Promise.all(POINTS.map(async (key) => addRows(key, await (await fetch(`history/${key}?${query}`)).json())));
}

async function start() {
  words = await (await fetch('words')).json();
  makeDesk(document.getElementById('desk'), words);
  connect();
  draw();
  setInterval(draw, 500);
}
start();
