"""A URScript program as the field writes it, about the calibrated cube of the cell `paper`."""

import numpy as np

from hilcell.geometry.frames import pose_from_zyx, to_rotvec

TURN_RAD = to_rotvec(pose_from_zyx(0.0, 0.0, 0.0, 0.0, 75.0, 0.0)[:3, :3])
OTHER_RAD = TURN_RAD * (1.0 - 2.0 * np.pi / np.linalg.norm(TURN_RAD))  # the same rotation
TURN, OTHER = (", ".join(f"{each:.9f}" for each in v) for v in (TURN_RAD, OTHER_RAD))

SCRIPT = f"""def drill():
  # p[1, 2, 3, 4, 5, 6] in a comment stays: movel(P1)
  $ 1 "Robot Program"
  set_tcp(p[0.18, 0.0, 0.21, 0.0, 0.0, 0.0])
  set_payload(1.5, [0.0, 0.0, 0.05])
  global P1=p[1.85, -.05, 0.95, {TURN}]
  local P2 = p[ 1.9, 5e-2 ,1, {OTHER}]
  P3=p[9, 9, 9, 0, 0, 0]
  speed = 0.25  # m/s
  def strike():
    set_standard_digital_out(0, True)
    sleep(0.5)
    textmsg("drilled p[1, 2, 3, 4, 5, 6]; movej(P1) # not", speed)
  end
  i = 0
  while (i < 2):
    movej(P1, a=1.4, v=1.05, r=0)
    movel(p[1.8000000001, 0.0, 0.9, {TURN}], 1.2, speed, 0, 0.0)
    strike()
    if i == 1 and not get_standard_digital_in(3):
      movel( P2 ,v=speed)
    else:
      movel(P1)
    end
    i = i + 1
  end
end
"""
