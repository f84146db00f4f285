"""Deliver one message to a web hook or a mail server: a separate program, which `receivers` starts and ends.

A server may treat its client in any way: send headers without end, or a byte a minute; a resolver may never answer.
Only a separate process can be ended in any state. It imports nothing but Python's standard library, so it runs from its
file, with no path but Python's.
"""

import json
import resource
import signal
import smtplib
import sys
import urllib.request
from email.message import EmailMessage
from email.utils import formatdate, make_msgid
from typing import Any

MEMORY_BYTES_MAX = 1 << 29  #: memory of the process for a web hook or mail server


class _NoRedirect(urllib.request.HTTPRedirectHandler):
    """Refuses redirects: a redirected POST would become a GET."""

    def redirect_request(self, *_: Any) -> None:
        return None


def post(url: str, data: Any, timeout_s: float) -> None:
    """Send data as JSON to an address, and read only the headers of the answer."""
    request = urllib.request.Request(
        url, json.dumps(data).encode(), {"Content-Type": "application/json"}, method="POST"
    )
    urllib.request.build_opener(_NoRedirect).open(request, timeout=timeout_s).close()


def send(server: tuple[str, int], sender: str, to: list[str], subject: str, text: str, timeout_s: float) -> None:
    """Send a mail through a server that needs no login."""
    mail = EmailMessage()
    mail["Subject"], mail["From"], mail["To"] = subject, sender, ", ".join(to)
    mail["Date"], mail["Message-ID"] = formatdate(), make_msgid(domain="rtrun")
    mail.set_content(text)
    with smtplib.SMTP(*server, timeout=timeout_s) as connection:
        connection.send_message(mail)


def main() -> str | None:
    """Deliver the message on standard input within its time limit; return the error in a line, or None."""
    message = json.load(sys.stdin)
    # Also works if the process that started this one was killed.
    signal.alarm(int(message["timeout_s"]) + 1)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES_MAX if hard < 0 else min(hard, MEMORY_BYTES_MAX), hard))
    try:
        if message["kind"] == "hook":
            post(message["url"], message["data"], message["timeout_s"])
        else:
            server = (message["host"], message["port"])
            send(server, message["sender"], message["to"], message["subject"], message["text"], message["timeout_s"])
    except Exception as error:  # a server can make the standard library raise anything
        reason = getattr(error, "strerror", None) or str(error) or type(error).__name__
        return " ".join(ascii(str(reason)[:300])[1:-1].split())
    return None


if __name__ == "__main__":
    sys.exit(main())
