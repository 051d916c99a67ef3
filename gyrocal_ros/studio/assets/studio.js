// Light or dark: as the machine has it, until the button is pressed.
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
