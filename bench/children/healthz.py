"""`python -m bench.children.healthz URL` asks for `/healthz` a hundred times a second until killed.

Prints for each request when it was sent, and when it was answered: seconds of the monotonic clock.
"""

import http.client
import sys
import time
from urllib.parse import urlsplit

_PAUSE_S = 0.01


def main() -> None:
    connection = http.client.HTTPConnection(urlsplit(sys.argv[1]).netloc)
    while True:
        sent = time.monotonic()
        connection.request("GET", "/healthz")
        connection.getresponse().read()
        print(sent, time.monotonic(), flush=True)
        time.sleep(_PAUSE_S)


if __name__ == "__main__":
    main()
