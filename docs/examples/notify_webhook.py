"""Posts a notification of hilcell to a web address: `notify_webhook.py URL_FILE < event.json`.

URL_FILE contains the address, which is often a secret: keep it readable for one user alone.
"""

import json
import sys
from pathlib import Path
from urllib.request import Request, urlopen

event = json.load(sys.stdin)
address = Path(sys.argv[1]).read_text("utf-8").strip()
if not address.startswith(("http://", "https://")):
    sys.exit(f"{sys.argv[1]}: expected an address that begins with https://")
text = f"{event['cell']}, run {event['run']}: {event['text']}"
body = json.dumps({"text": text}).encode()  # of Slack, Mattermost and Rocket.Chat
request = Request(address, body, {"Content-Type": "application/json"})  # noqa: S310 - checked above
with urlopen(request, timeout=4.0):  # noqa: S310 - checked above
    pass
