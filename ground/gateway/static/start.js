// Start Open MCT with the daemon's telemetry; a file of its own, for the page runs no inline script.
fetch('objects').then((answer) => answer.json()).then((tree) => {
  if (!location.hash) location.hash = `#/browse/${tree.start}?hideTree=true&hideInspector=true`;
  openmct.setAssetPath('openmct/');
  openmct.install(openmct.plugins.LocalStorage());
  openmct.install(openmct.plugins.Espresso());
  openmct.install(openmct.plugins.UTCTimeSystem());
  openmct.install(openmct.plugins.LADTable());
  openmct.install(openmct.plugins.DisplayLayout());
  openmct.install(openmct.plugins.Conductor({ menuOptions: [
    { name: 'Live', timeSystem: 'utc', clock: 'local', clockOffsets: { start: -120000, end: 5000 } },
    { name: 'Fixed', timeSystem: 'utc', bounds: { start: Date.now() - 3600000, end: Date.now() } }
  ] }));
  openmct.install(inertiaPlugin(tree));
  openmct.start(document.getElementById('page'));
});
