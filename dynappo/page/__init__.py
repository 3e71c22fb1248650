"""A page: one HTML file that plays an episode in a browser, with nothing to install.

- `episode_page`: writes it, and says what it draws; `page.html` and `page.js` are the player in it

`play` and `evaluate` import it. It imports `policy` and `config`, and no JAX.
"""
