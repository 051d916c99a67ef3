// Figures on the page whose horizontal axis has a name.
function linkedGraphs() {
  return [...document.querySelectorAll('.js-plotly-plot')].filter((graph) => graph.layout?.meta?.axis);
}

// Light or dark: by the setting of the machine, until the button is pressed.
window.dash_clientside = Object.assign({}, window.dash_clientside, {
  studio: {
    theme: function (clicks, stored) {
      const dark = window.matchMedia('(prefers-color-scheme: dark)').matches;
      let theme = stored || (dark ? 'dark' : 'light');
      if (clicks) theme = theme === 'dark' ? 'light' : 'dark';
      if (clicks || stored) document.documentElement.className = theme;
      return clicks ? theme : window.dash_clientside.no_update;
    },
    // Zooms every figure that has the horizontal axis of the one that was zoomed.
    zoom: function () {
      const { triggered } = window.dash_clientside.callback_context;
      for (const { prop_id: source, value: change } of triggered) {
        const from = document.querySelector(`#${source.split('.')[0]} .js-plotly-plot`);
        const key = Object.keys(change || {}).find((name) => /^xaxis\d*\.(range|autorange)/.test(name));
        if (!key || !from) continue;
        const range = from.layout[key.split('.')[0]].range.map(Number);
        for (const graph of linkedGraphs()) {
          const isLinked = graph !== from && graph.layout.meta.axis === from.layout.meta?.axis;
          const differs = graph.layout.xaxis.range.some((end, side) => Math.abs(end - range[side]) > 1e-6);
          if (isLinked && differs) window.Plotly.relayout(graph, { 'xaxis.range': range });
        }
      }
    },
  },
});

// Dash gives radio buttons the roles of a list, too: a screen reader would announce each twice.
(function () {
  function simplify() {
    for (const part of document.querySelectorAll('.choice[role], .choice [role=option]')) part.removeAttribute('role');
    for (const part of document.querySelectorAll('.choice [aria-selected]')) part.removeAttribute('aria-selected');
  }
  new MutationObserver(simplify).observe(document.documentElement, {
    subtree: true, childList: true, attributes: true, attributeFilter: ['role', 'aria-selected'],
  });
})();

// Shows a message if the server does not answer: without it the page would look as before.
(function () {
  const originalFetch = window.fetch;
  const alert = document.createElement('p');
  alert.id = 'gone';
  alert.setAttribute('role', 'alert');
  function show(isGone) {
    const message = 'The studio does not answer: start it again with the same command, nothing is lost.';
    alert.textContent = isGone ? message : '';
    if (!alert.isConnected) document.body.prepend(alert);
  }
  window.fetch = async function (...args) {
    try {
      const response = await originalFetch.apply(this, args);
      show(false);
      return response;
    } catch (error) {
      show(true);
      throw error;
    }
  };
})();

// Marks a place where the model fails in all figures while the pointer or the focus is on its row.
(function () {
  const name = 'place';
  function mark(ranges) {
    for (const graph of linkedGraphs()) {
      const shapes = (graph.layout.shapes || []).filter((shape) => shape.name !== name);
      for (const [x0, x1] of ranges[graph.layout.meta.axis] || [])
        shapes.push({ name, type: 'rect', xref: 'x', yref: 'paper', x0, x1, y0: 0, y1: 1, layer: 'below',
          fillcolor: 'rgba(0,114,178,0.25)', line: { color: '#0072B2', width: 1 } });
      window.Plotly.relayout(graph, { shapes });
    }
  }
  for (const kind of ['mouseover', 'mouseout', 'focusin', 'focusout'])
    document.addEventListener(kind, (event) => {
      const row = event.target.closest && event.target.closest('[data-place]');
      if (row) mark(kind === 'mouseover' || kind === 'focusin' ? JSON.parse(row.dataset.place) : {});
    });
})();

// Recordings that are dropped on the page, or chosen with its button, are sent in pieces, checked and opened.
(function () {
  const PIECE = 2 ** 19;
  const chooser = Object.assign(document.createElement('input'), { type: 'file', multiple: true });

  function show(text, isError) {
    const state = document.getElementById('upload-state');
    state.textContent = text;
    state.className = isError ? 'error-message' : '';
  }

  async function send(address, method, body) {
    const answer = await fetch(address, { method, body });
    if (!answer.ok) throw new Error(await answer.text());
  }

  async function open(bag, files) {
    const address = `/upload/${encodeURIComponent(bag)}`;
    const whole = files.reduce((sum, file) => sum + file.size, 0);
    let sent = 0;
    try {
      for (const file of files) {
        for (let at = 0; at === 0 || at < file.size; at += PIECE) {
          const piece = file.slice(at, at + PIECE);
          const place = `${encodeURIComponent(file.name)}?at=${at}&whole=${whole}`;
          await send(`${address}/${place}`, 'PUT', piece);
          sent += piece.size;
          show(`Receiving ${bag}: ${Math.floor((100 * sent) / Math.max(whole, 1))} %`);
        }
      }
      show(`Checking ${bag}`);
      await send(address, 'POST');
      location.reload();
    } catch (error) {
      show(error.message, true);
    }
  }

  // A file is a bag of its own; several, or those of a folder, are one bag.
  function openFiles(files) {
    const stem = files.find((file) => !file.name.endsWith('.yaml'))?.name.replace(/\.[^.]*$/, '');
    if (files.length) open(stem || files[0].name, files);
  }

  function openFolder(folder) {
    folder.createReader().readEntries(async (entries) => {
      const inside = entries.filter((entry) => entry.isFile && /\.(yaml|mcap|db3|bag)$/.test(entry.name));
      open(folder.name, await Promise.all(inside.map((entry) => new Promise((take) => entry.file(take)))));
    });
  }

  const isHere = () => document.getElementById('upload') !== null;
  document.addEventListener('click', (event) => event.target.id === 'upload' && chooser.click());
  chooser.addEventListener('change', () => {
    openFiles([...chooser.files]);
    chooser.value = '';
  });
  document.addEventListener('dragover', (event) => isHere() && event.preventDefault());
  document.addEventListener('drop', (event) => {
    if (!isHere()) return;
    event.preventDefault();
    const entry = event.dataTransfer.items[0]?.webkitGetAsEntry?.();
    if (entry?.isDirectory) openFolder(entry);
    else openFiles([...event.dataTransfer.files]);
  });
})();
