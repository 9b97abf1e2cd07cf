"""The built site in a browser without a screen."""

import contextlib
import functools
import http.server
import shutil
import subprocess
import threading

BROWSER = shutil.which("chromium") or shutil.which("google-chrome")


class Handler(http.server.SimpleHTTPRequestHandler):
    """Serve a folder, and pages besides that are given as text."""

    def __init__(self, *arguments, pages, **options):
        self.pages = pages
        super().__init__(*arguments, **options)

    def do_GET(self):
        if self.path not in self.pages:
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(self.pages[self.path].encode())

    def log_message(self, *_):
        """Say nothing."""


@contextlib.contextmanager
def served(folder, **pages):
    """The address of a folder, and of these pages beside it."""
    handler = functools.partial(
        Handler, directory=str(folder), pages={f"/{name}": text for name, text in pages.items()}
    )
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()


def after_scripts(address, seconds=600):
    """What a page has become once its scripts have run, for at most so many seconds of its own clock."""
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", f"--virtual-time-budget={1000 * seconds}"]
    return subprocess.run([*command, "--dump-dom", address], capture_output=True, text=True, timeout=500).stdout
