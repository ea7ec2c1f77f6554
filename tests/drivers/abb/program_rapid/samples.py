"""RAPID modules as the field writes them, about the calibrated cube of the cell `paper`."""

from __future__ import annotations

import pytest

from drivers.abb.program_rapid.files import read_program
from drivers.abb.program_rapid.program import Program
from drivers.program_text import ENCODING
from hilcell.cell.settings import SettingsError
from hilcell.ports import Array

NONE = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
TURN = "[0.793353340,0,0.608761429,0]"  # 75 deg about y
REST = f"[0,-1,0,1],{NONE}"

MODULE = rf"""%%%
  VERSION:1
  LANGUAGE:ENGLISH
%%%
MODULE Drill_Wing(SYSMODULE, NOSTEPIN)
  ! [[1,2,3],[1,0,0,0]] in a comment stays: MoveL p10
  PERS tooldata tDrill:=[TRUE,[[98,0,127],[1,0,0,0]],[4.5,[0,0,80],[1,0,0,0],0,0,0]];
  LOCAL VAR num nCount;
  CONST robtarget p10:=[[-200.0,100.123456,1000.5],{TURN},{REST}];
  LOCAL PERS robtarget pHole{{2}}:=[[[0,0,1200],{TURN},{REST}],
    [[0.0,+5E1,1200.], [-0.793353340, 0 ,-0.608761429,0] ,{REST}]];
  CONST robtarget pSpare:=[[1,2,3],[1,0,0,0],[0,0,0,0],{NONE}];
  CONST jointtarget jHome:=[[0,-20,20,0,75,0],{NONE}];
  CONST num nStroke:=8;
  LOCAL CONST speeddata vHole:=[20,10,1000,1000];

  PROC main()
    VAR robtarget pFree;
    MoveAbsJ jHome\NoEOffs, v1000, z50, tDrill\WObj:=wobj0;
    TPWrite "drill ""p10""; MoveL p10! done";
    IF diReady = 0 WaitDI diReady, 1;
    MoveJ p10, v1000\V:=500, z10, tDrill;
    moveL
      P10, v200, fine
      \Inpos := inpos50, tDrill \WObj:=wobj0;
    FOR i FROM 1 TO 2 DO
      Strike pHole{{i}}, nStroke;
    ENDFOR
    MoveL [[100.5,-20,1150.25],{TURN},{REST}],v100,fine,tDrill;
    TEST nCount
    CASE 1, 2:
      Incr nCount;
    DEFAULT:
      CallGripper 3;
    ENDTEST
    again:
    pFree := CRobT(\Tool:=tDrill);
    IF nCount > 3 GOTO again;
    MoveAbsJ jHome, v1000, fine, tDrill;
  ERROR
    IF ERRNO = ERR_WAIT_MAXTIME RETRY;
  ENDPROC

  LOCAL PROC Strike(robtarget p, num depth \switch Fast)
    MoveJ Offs(p, 0, 0, 10), v500, z1, tDrill;
    MoveL p, vHole, fine, tDrill;
    MoveL RelTool(p, 0, 0, depth), vHole, fine, tDrill;
    SetDO doDrill, 1;
    MoveL Offs(p, 0, 0, 10), v500, z1, tDrill;
  ENDPROC

  TRAP tPressed
    Stop;
  ENDTRAP
ENDMODULE
"""

HEAD = rf"""MODULE m
PERS tooldata t:=[TRUE,[[98,0,127],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS wobjdata w:=[FALSE,TRUE,"",[[1,0,0],[1,0,0,0]],[[0,2,0],[1,0,0,0]]];
CONST robtarget p1:=[[1,2,3],[1,0,0,0],[0,0,0,0],{NONE}];
CONST robtarget p2:=[[4,5,6],[1,0,0,0],[0,0,0,0],{NONE}];
CONST jointtarget j1:=[[0,0,0,0,90,0],{NONE}];
"""
BODY = HEAD.count("\n") + 2  # the line of the first statement of `one`


def module(routines: str, data: str = "") -> Program:
    return read_program("drill.mod", f"{HEAD}{data}{routines}\nENDMODULE\n")


def one(body: str, data: str = "") -> Program:
    """Return a program whose body begins on line `BODY` where there is no more data."""
    return module(f"PROC main()\n{body}\nENDPROC", data)


def moved(read: Program, positions: Array, remark: str = "") -> str:
    ((name, content),) = read.with_positions(positions, remark).items()
    assert name == read.file
    return content.decode(ENCODING)


def refusal(body: str, data: str = "") -> str:
    with pytest.raises(SettingsError) as raised:
        one(body, data)
    return "\n".join(raised.value.problems)
