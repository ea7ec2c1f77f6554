"""The ways of sending a target, in words; the keys stand in `PointId.how` and in results."""

AS_SENT, PAPER, CORRECTED = "as sent", "paper method", "corrected"
WAYS = {"before": AS_SENT, "idw": PAPER, "chosen": CORRECTED}
SHORT_WAYS = WAYS | {"idw": "paper"}  # where there are few letters
