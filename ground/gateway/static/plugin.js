// The daemon's telemetry in Open MCT: objects from the server, history by request, live values by one socket.
function inertiaPlugin(tree) {
  return function install(openmct) {
    const listeners = new Map(); // key -> set of functions
    const stalenessListeners = new Map();
    const datum = ([utc, value]) => ({ utc, value });
    const isPoint = (object) => object.type === 'inertia.point';
    const isOurs = (object) => isPoint(object) || object.type === 'inertia.events';
    const keyOf = (object) => object.identifier.key;
    const packetOf = (object) => keyOf(object).split('.')[0];
    let stale = new Set(['*']);
    let socket;

    const isStale = (object) => ({
      isStale: stale.has('*') || stale.has(packetOf(object)),
      timestamp: Date.now(),
      utc: Date.now()
    });
    const send = (message) => {
      if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
    };

    const indicator = openmct.indicators.simpleIndicator();
    indicator.iconClass('icon-connectivity');
    const show = (text, status, description) => {
      indicator.text(text);
      indicator.statusClass(status);
      indicator.description(description);
    };
    openmct.indicators.add(indicator);

    function tellStaleness(packets, reason) {
      stale = new Set(packets);
      for (const [object, callbacks] of stalenessListeners)
        callbacks.forEach((callback) => callback(isStale(object)));
      if (reason) show(`STALE: ${reason}`, 's-status-error', 'No telemetry from the daemon');
      else if (stale.size) show(`STALE: ${[...stale].join(', ')}`, 's-status-warning-hi', 'Overdue');
      else show('LIVE', 's-status-on', 'Telemetry is coming');
    }

    function connect() {
      socket = new WebSocket(`${location.origin.replace('http', 'ws')}/stream`);
      socket.onopen = () => send({ subscribe: [...listeners.keys()] });
      socket.onclose = () => {
        tellStaleness(['*'], 'no gateway');
        setTimeout(connect, 1000);
      };
      socket.onmessage = ({ data }) => {
        const message = JSON.parse(data);
        if (message.stale)
          tellStaleness(message.link.connected ? message.stale : ['*'],
            message.link.connected ? '' : message.link.reason);
        for (const [key, values] of Object.entries(message.points))
          for (const callback of listeners.get(key) ?? [])
            values.forEach((value) => callback(datum(value)));
        for (const callback of listeners.get('events') ?? []) message.events.forEach((event) => callback(event));
      };
    }

    openmct.types.addType('inertia.point', { name: 'Telemetry point', cssClass: 'icon-telemetry' });
    openmct.types.addType('inertia.events', { name: 'Events', cssClass: 'icon-bell' });
    openmct.objects.addRoot({ namespace: 'inertia', key: 'root' }, openmct.priority.HIGH);
    openmct.objects.addProvider('inertia', {
      get: ({ key }) => Promise.resolve(structuredClone(tree.objects[key]))
    });
    openmct.telemetry.addProvider({
      supportsRequest: isOurs,
      request: async (object, options) => {
        const latest = isPoint(object) && options.strategy === 'latest';
        const query = new URLSearchParams({
          start: options.start, end: options.end, size: options.size ?? 1000
        });
        const path = latest ? `latest/${keyOf(object)}` : `history/${keyOf(object)}?${query}`;
        const rows = await (await fetch(path, { signal: options.signal })).json();
        return isPoint(object) ? rows.map(datum) : rows;
      },
      supportsSubscribe: isOurs,
      subscribe: (object, callback) => {
        const key = keyOf(object);
        if (!listeners.has(key)) listeners.set(key, new Set());
        listeners.get(key).add(callback);
        send({ subscribe: [key] });
        return () => {
          listeners.get(key).delete(callback);
          if (!listeners.get(key).size) {
            listeners.delete(key);
            send({ unsubscribe: [key] });
          }
        };
      },
      supportsStaleness: isPoint,
      isStale: (object) => Promise.resolve(isStale(object)),
      subscribeToStaleness: (object, callback) => {
        if (!stalenessListeners.has(object)) stalenessListeners.set(object, new Set());
        stalenessListeners.get(object).add(callback);
        return () => stalenessListeners.delete(object);
      }
    });
    show('STALE: starting', 's-status-warning-lo', 'Not connected yet');
    connect();
  };
}
