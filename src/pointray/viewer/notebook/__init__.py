"""Widget of notebooks: the viewer's page in a cell, connected by the notebook's own messages, without a port.

`widget.ViewerWidget` holds a `SharedScene` and `page_views`: for each cell that shows it, a `Session` as a browser has
one, and a `comm_link` in place of the WebSocket. `embedded_page` makes the module of the page from `widget.js` and the
files of the viewer's page. `snapshot` draws pictures for Python and for saved notebooks. `detection` finds out whether
code runs in a notebook.

Read first: `widget`, then `page_views`.
"""
