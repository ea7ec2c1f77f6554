"""KRL programs as the field writes them."""

from __future__ import annotations

from pathlib import Path

import pytest

from drivers.kuka.program_krl.files import read_program
from drivers.kuka.program_krl.program import Program
from drivers.program_text import ENCODING
from hilcell.cell.settings import SettingsError
from hilcell.ports import Array
from tests.hilcell.commands import workplace

SRC = """&ACCESS RVP
&REL 12
&PARAM TEMPLATE = C:\\KRC\\Roboter\\Template\\vorgabe
DEF drill( )
;FOLD INI;%{PE}
  ;FOLD BASISTECH INI
    GLOBAL INTERRUPT DECL 3 WHEN $STOPMESS==TRUE DO IR_STOPM ( )
    INTERRUPT ON 3
    BAS (#INITMOV,0 )
  ;ENDFOLD (BASISTECH INI)
;ENDFOLD (INI)
DECL INT I

;FOLD PTP HOME Vel=100 % DEFAULT;%{PE}%R 8.3.32
$BWDSTART=FALSE
PDAT_ACT=PDEFAULT
FDAT_ACT=FHOME
BAS(#PTP_PARAMS,100)
$H_POS=XHOME
PTP XHOME
;ENDFOLD
;FOLD PTP P1 CONT Vel=100 % PDAT1 Tool[1] Base[2];%{PE}
$BWDSTART=FALSE
PDAT_ACT=PPDAT1
FDAT_ACT=FP1
BAS(#PTP_PARAMS,100)
PTP XP1 C_PTP
;ENDFOLD
LDAT_ACT=LCPDAT1
FDAT_ACT=FP2
BAS(#CP_PARAMS,0.5)
lin xp2 ; X 1.0 in a comment stays
LIN {X 10.5,Y -20, Z 1250.25 ,A 0.0,B 75.0,C 0.0} C_DIS
FOR I=1 TO 2
  LIN HOLE[I] C_DIS
  DRILL_ONE ( )
ENDFOR
WAIT SEC 0.5
TRIGGER WHEN DISTANCE=0 DELAY=0 DO $OUT[3]=FALSE
CHECK_HOLE(12, "XP1;{X 1}")
PTP XP1
PTP HOME
END

DEF DRILL_ONE( )
  $OUT[3]=TRUE
END
"""

DAT = """&ACCESS RVP
&REL 12
DEFDAT  DRILL PUBLIC
;FOLD EXTERNAL DECLARATIONS;%{PE}%MKUKATPBASIS
EXT  BAS (BAS_COMMAND  :IN,REAL  :IN )
DECL INT SUCCESS
;ENDFOLD
DECL E6POS XP1={X -200.0,Y 100.123456,Z +1000.5,A 0.0,B 75.0,C 0.0,S 6,T 19,E1 0.0,E2 0.0}
DECL FDAT FP1={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] " ",TQ_STATE FALSE}
decl pos xp2={pos: x 1E2, y -.5, z 1100., a 0, b 75, c 0, s 6, t 19} ; 2nd
DECL FDAT FP2={TOOL_NO 1,BASE_NO 2,IPO_FRAME #BASE,POINT2[] "XP1"}
DECL E6POS XP3={X 1.0,Y 2.0,Z 3.0,A 0.0,B 0.0,C 0.0,S 6,T 19}
DECL E6AXIS XHOME={A1 0.0,A2 -90.0,A3 90.0,A4 0.0,A5 0.0,A6 0.0}
FRAME HOLE[2]
HOLE[1]={X 0.0,Y 0.0,Z 1200.0,A 0.0,B 75.0,C 0.0}
HOLE[2]={X 0.0,Y 50.0,Z 1200.0,A 0.0,B 75.0,C 0.0}
DECL PDAT PPDAT1={VEL 100.000,ACC 100.000,APO_DIST 100.000}
ENDDAT
"""
P1 = "DECL E6POS XP1={X 1.0,Y 2.0,Z 3.0,A 0.0,B 75.0,C 0.0,S 6,T 19,E1 0.0}\n"
P2 = "DECL E6POS XP2={X 4.0,Y 5.0,Z 6.0,A 0.0,B 75.0,C 0.0,S 6,T 19,E1 0.0}\n"


def program(src: str = SRC, dat: str | None = DAT) -> Program:
    return read_program("drill.src", src, None if dat is None else ("drill.dat", dat))


def one(body: str, dat: str = "") -> Program:
    """Return a program whose body begins on line 2."""
    return program(f"DEF drill()\n{body}\nEND\n", dat)


def moved(read: Program, positions_mm: Array) -> dict[str, str]:
    """Return the texts with other positions."""
    files = read.with_positions(positions_mm)
    return {name: content.decode(ENCODING) for name, content in files.items()}


def refusal(body: str, dat: str = "") -> str:
    with pytest.raises(SettingsError) as raised:
        one(body, dat)
    return "\n".join(raised.value.problems)


class Workplace(workplace.Workplace):
    """A folder with a calibration and a KRL program, and the command over them."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, "drill.src", "out.src")
        self.program()

    def program(self, src: str = SRC, dat: str = DAT) -> None:
        self.source.write_text(src, "latin-1")
        self.source.with_suffix(".dat").write_text(dat, "latin-1")
