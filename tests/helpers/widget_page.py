"""A page of the notebook widget without a notebook: it sends messages like `widget.js`, and keeps those it receives."""

import json
import struct
import threading
from queue import SimpleQueue

from helpers.viewer_client import SECONDS


class WidgetPage:
    """One view of a widget. `post` receives the messages of the kernel, `receive` is the kernel's handler.

    Like a notebook, it processes messages in a thread of its own.
    """

    def __init__(self, receive, view="one", size=(160, 120)):
        self.view, self._receive, self._size = view, receive, size
        self.states, self.told, self.frames = [], [], []
        self._changed, self._queue = threading.Condition(), SimpleQueue()
        self._thread = threading.Thread(target=self._run, name="page")
        self._thread.start()

    def open(self):
        """Connect, and say the size of the view."""
        self._receive({"view": self.view, "state": "open"})
        width, height = self._size
        self.say(type="size", width=width, height=height)
        return self

    def say(self, **message):
        self._receive({"view": self.view, "text": json.dumps(message)})

    def post(self, content, buffers=None):
        """Take a message of the kernel."""
        if content["view"] == self.view:
            self._queue.put((content, buffers))

    def close(self):
        self._queue.put(None)
        self._thread.join(SECONDS)

    def _run(self):
        while (message := self._queue.get()) is not None:
            self._take(*message)

    def _take(self, content, buffers):
        """Keep a message; acknowledge it, and each picture."""
        seen = None
        with self._changed:
            if "state" in content:
                self.states.append(content["state"])
            elif "text" in content:
                self.told.append(json.loads(content["text"]))
            else:
                length = struct.unpack("<I", buffers[0][:4])[0]
                header = json.loads(buffers[0][4 : 4 + length])
                self.frames.append((header, buffers[0][4 + length :]))
                seen = header["number"]
            self._changed.notify_all()
        if content.get("state") in ("gone", "ended", "replaced"):
            return
        self._receive({"view": self.view, "read": content["bytes"]})
        if seen is not None:
            self.say(type="seen", number=seen)

    def wait(self, condition):
        """Wait until a condition holds, and return its value."""
        with self._changed:
            found = self._changed.wait_for(condition, SECONDS)
        assert found, f"nothing came; last: {[m.get('type') for m in self.told[-5:]]}"
        return found

    def last(self, kind):
        """The newest message of a type, or None."""
        return next((m for m in reversed(self.told) if m["type"] == kind), None)

    def finished(self, samples, after=0):
        """Wait for a picture with this many samples after a given number of pictures; return its header and file."""
        return self.wait(lambda: next((f for f in self.frames[after:] if f[0]["samples"] == samples), None))
