"""Sends a notification of hilcell as a mail: `notify_mail.py SERVER FROM TO < event.json`."""

import json
import smtplib
import sys
from email.message import EmailMessage

event = json.load(sys.stdin)
server, sender, receiver = sys.argv[1:]
mail = EmailMessage()
mail["From"], mail["To"] = sender, receiver
mail["Subject"] = f"hilcell {event['cell']}: {event['text'][:100]}"
steps = "\n".join(event.get("next", event.get("do", [])))
mail.set_content(f"{event['text']}\n\n{steps}\n\nrun {event['run']} in {event['folder']}\n")
host, _, port = server.partition(":")
with smtplib.SMTP(host, int(port or 25), timeout=4.0) as connection:
    connection.send_message(mail)
