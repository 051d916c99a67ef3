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
