"""A TP listing as the field writes it, about the calibrated cube of the cell `paper`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
import pytest

from drivers.fanuc.program_tp import Program, read_program
from drivers.program_text import ENCODING
from hilcell.cell.settings import SettingsError
from hilcell.geometry.frames import matrix
from hilcell.ports import Array

LISTING = """/PROG  DRILL
/ATTR
OWNER\t\t= MNEDITOR;
COMMENT\t\t= "P[1] 500.0  mm";
PROG_SIZE\t= 1034;
CREATE\t\t= DATE 26-01-05  TIME 12:14:58;
LINE_COUNT\t= 17;
PROTECT\t\t= READ_WRITE;
TCD:  STACK_SIZE\t= 0,
      PAUSE_REQUEST\t= 0;
DEFAULT_GROUP\t= 1,*,*,*,*;
CONTROL_CODE\t= 00000000 00000000;
/APPL

AUTO_SINGULARITY_HEADER;
  ENABLE_SINGULARITY_AVOIDANCE   : FALSE;
/MN
   1:  !P[1] = 1.0 mm, it stays ;
   2:  --eg: a remark
    :  of two lines: L P[9] ;
   3:  UFRAME_NUM=1 ;
   4:  UTOOL_NUM=1 ;
   5:J P[1:home] 100% FINE    ;
   6:  //J PR[3] 20% FINE    ;
   7:  LBL[1:hole, P7] ;
   8:J P[2] 100% CNT100 ACC80    ;
   9:L P[3:"hole 1] R[10:feed]mm/sec FINE
    :  PTH TB    .10sec,DO[114:drill]=(DI[1] AND DI[2])    ;
  10:  WAIT DI[3:back]=ON TIMEOUT,LBL[1] ;
  11:  IF DI[52:done, so far]=OFF,CALL COUNT(1,'P[3]') ;
  12:  IF (R[1:n]<10),JMP LBL[1] ;
  13:  R[1:n]=R[1:n]+1    ;
  14:  MESSAGE[L P[3] isn't, done] ;
  15:  ;
  16:L P[3] max_speed FINE    ;
  17:J P[1:home] 50% FINE    ;
/POS
P[1:"home"]{
   GP1:
\tUF : F, UT : F,\t
\tJ1=     0.000 deg,\tJ2=   -30.000 deg,\tJ3=     0.000 deg,
\tJ4=     0.000 deg,\tJ5=   -90.000 deg,\tJ6=     0.000 deg
};
P[2]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =  -200.000  mm,\tY =   100.123  mm,\tZ =  1000.500  mm,
\tW =     0.000 deg,\tP =    75.000 deg,\tR =     0.000 deg
};
P[3:"hole }; 1"]{
   GP1:
\tUF : 1, UT : 1,\t\tCONFIG : 'F U T, 0, 0, 0',
\tX =      .054  mm,\tY =\t-50.000000\tmm,\tZ =1200.000  mm,
\tW =     0.000 deg,\tP =    75.000 deg,\tR =     -.500 deg
};
P[4]{
   GP1:
\tUF : F, UT : F,\t\tCONFIG : 'N D B, 0, 0, 0',
\tX = ********  mm,\tY = ********  mm,\tZ = ********  mm,
\tW = ******** deg,\tP = ******** deg,\tR = ******** deg
};
/END
"""
POSITION = """P[{n}]{{
   GP1:
\tUF : {uf}, UT : {ut},\t\tCONFIG : '{config}',
\tX = {x:9.3f}  mm,\tY = {y:9.3f}  mm,\tZ = {z:9.3f}  mm,
\tW = {w:9.3f} deg,\tP = {p:9.3f} deg,\tR = {r:9.3f} deg{more}
}};
"""
HOME = """P[1]{
   GP1:
\tUF : 1, UT : 1,
\tJ1= 0.000 deg,\tJ2= 0.000 deg,\tJ3= 0.000 deg,\tJ4= 0.0 deg,\tJ5= -90.0 deg,\tJ6= 0.0 deg
};
"""


def position(n: int, *values: float, more: str = "", **stated: object) -> str:
    """Return P[n] at X, Y, Z, W, P, R, in UF 1 with UT 1 unless others are given."""
    known: dict[str, object] = {"uf": 1, "ut": 1, "config": "F U T, 0, 0, 0"} | stated
    numbers = dict(zip("xyzwpr", values or (0.0, 0.0, 1200.0, 0.0, 75.0, 0.0), strict=True))
    return POSITION.format(n=n, more=more, **numbers, **known)


def listing(statements: Sequence[str], positions: str = "", groups: str = "1,*,*,*,*") -> str:
    """Return a program whose n-th statement is in line n + 4, and /POS in the line after them."""
    body = "".join(f"{n:4d}:{each} ;\n" for n, each in enumerate(statements, start=1))
    head = f"/PROG  DRILL\n/ATTR\nDEFAULT_GROUP = {groups};\n/MN\n"
    return f"{head}{body}/POS\n{positions}/END\n"


def one(*statements: str, positions: str | None = None) -> Program:
    given = position(2) + position(3) if positions is None else positions
    return read_program("drill.ls", listing(statements, HOME + given))


def refusals(text: str) -> list[str]:
    with pytest.raises(SettingsError) as raised:
        read_program("drill.ls", text)
    return list(raised.value.problems)


def moved(read: Program, positions: Array, remark: str = "") -> str:
    ((name, content),) = read.with_positions(positions, remark).items()
    assert name == read.file
    return content.decode(ENCODING)


def parsed(text: str) -> tuple[Mapping[str, Array], list[tuple[str, str]]]:
    """Poses (4, 4) of a listing by their name in motions, and its motions (J or L, name).

    It shares nothing with the reader: what a controller takes from the text, by its marks alone.
    """
    body, _, data = text.replace("\r\n", "\n").partition("\n/POS\n")
    poses = dict[str, Array]()
    for block in data.split("};"):
        if "CONFIG" in block:
            head, _, rest = block.strip().partition("{")
            x, y, z, w, p, r = (
                float(re.split(rf"\b{letter}\s*=\s*", rest)[1].split()[0]) for letter in "XYZWPR"
            )
            turn = np.eye(3)
            for axis, deg in enumerate((w, p, r)):  # about the fixed X, then Y, then Z
                c, s, k = np.cos(np.radians(deg)), np.sin(np.radians(deg)), np.eye(3)[axis]
                cross = np.cross(np.eye(3), k)
                turn = (np.eye(3) + s * cross + (1.0 - c) * cross @ cross) @ turn
            poses[head.replace('"', "")] = matrix(turn, np.array([x, y, z]))
    moves = re.findall(r"^ *\d+:([JL]) (P\[[^\]]*\])", body, re.MULTILINE)
    return poses, moves
