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
