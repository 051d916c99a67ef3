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

// A page whose studio has ended looks alive and does nothing, so it is told.
(function () {
  const ask = window.fetch;
  const words = document.createElement('p');
  words.id = 'gone';
  words.setAttribute('role', 'alert');
  function tell(isGone) {
    const told = 'The studio does not answer: start it again with the same command, nothing is lost.';
    words.textContent = isGone ? told : '';
    if (!words.isConnected) document.body.prepend(words);
  }
  window.fetch = async function (...order) {
    try {
      const answer = await ask.apply(this, order);
      tell(false);
      return answer;
    } catch (error) {
      tell(true);
      throw error;
    }
  };
})();
