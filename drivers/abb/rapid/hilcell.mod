MODULE hilcell
  ! hilcell: motions, their watchdog, and the position stream, in task T_ROB1.
  ! The PC writes hc_target and hc_seconds, then a number into hc_order: it starts the motion, and
  ! hc_state shows it when the motion has ended. The PC counts hc_life up meanwhile; where it does
  ! not for 1.5 s, the motion is stopped. The robot moves by MoveAbsJ to fine points alone.
  CONST num hc_version:=1;
  CONST num hc_life_s:=1.5;
  ! Written by the PC. hc_brake is the number of the order to brake.
  PERS num hc_session:=0;
  PERS num hc_life:=0;
  PERS num hc_order:=0;
  PERS num hc_brake:=0;
  PERS num hc_seconds:=1;
  PERS jointtarget hc_target:=[[0,0,0,0,30,0],[9E9,9E9,9E9,9E9,9E9,9E9]];
  ! Written here: version, session, hc_life as seen, last order ended, its error, order begun.
  ! Errors: 0 none, 8 the PC's life sign was late, 9 braked.
  PERS num hc_state{6}:=[0,0,0,0,0,0];
  ! The reflector's centre on the flange, without rotation, and the load.
  PERS tooldata hc_tool:=[TRUE,[[0,0,0],[1,0,0,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
  LOCAL VAR egmident hc_egm;
  LOCAL VAR intnum hc_life_seen;
  LOCAL VAR intnum hc_brake_seen;
  LOCAL VAR intnum hc_tick;
  LOCAL VAR clock hc_clock;
  LOCAL VAR num hc_heard_s:=0;
  LOCAL VAR bool hc_moves:=FALSE;
  LOCAL VAR errnum HC_STOPPED:=-1;

  PROC hc_main()
    BookErrNo HC_STOPPED;
    hc_moves:=FALSE;
    hc_order:=0;
    hc_brake:=0;
    hc_state:=[hc_version,0,hc_life,0,0,0];
    ClkReset hc_clock;
    ClkStart hc_clock;
    IDelete hc_life_seen;
    CONNECT hc_life_seen WITH hc_hear;
    IPers hc_life,hc_life_seen;
    IDelete hc_brake_seen;
    CONNECT hc_brake_seen WITH hc_take_brake;
    IPers hc_brake,hc_brake_seen;
    IDelete hc_tick;
    CONNECT hc_tick WITH hc_check_life;
    ITimer 0.25,hc_tick;
    EGMReset hc_egm;
    EGMGetId hc_egm;
    EGMSetupUC ROB_1,hc_egm,"default","UCdevice"\Joint;
    EGMStreamStart hc_egm\SampleRate:=4;
    ! The session last: from here on the PC gives orders.
    hc_state{2}:=hc_session;
    WHILE TRUE DO
      WaitUntil hc_order<>hc_state{4}\PollRate:=0.04;
      hc_move;
    ENDWHILE
  ENDPROC

  PROC hc_move()
    VAR num number;
    number:=hc_order;
    hc_state{6}:=number;
    ! A brake may come before its order.
    IF hc_brake=number THEN
      hc_state{5}:=9;
      hc_state{4}:=number;
      RETURN;
    ENDIF
    hc_state{5}:=0;
    hc_heard_s:=ClkRead(hc_clock);
    hc_moves:=TRUE;
    MoveAbsJ hc_target\NoEOffs,v1000\T:=hc_seconds,fine,hc_tool;
    hc_moves:=FALSE;
    hc_state{4}:=number;
  ERROR (HC_STOPPED)
    ! A trap has stopped the motion, and has left it by a long jump to here: what is left of the
    ! path is dropped, the robot stays. Other errors stop the program; the event log has them.
    ClearPath;
    StartMove;
    hc_state{4}:=number;
    RETURN;
  ENDPROC

  LOCAL TRAP hc_hear
    hc_heard_s:=ClkRead(hc_clock);
    hc_state{3}:=hc_life;
  ENDTRAP

  LOCAL TRAP hc_take_brake
    IF hc_moves AND hc_brake=hc_state{6} THEN
      StopMove\Quick;
      hc_moves:=FALSE;
      hc_state{5}:=9;
      RAISE HC_STOPPED;
    ENDIF
  ENDTRAP

  LOCAL TRAP hc_check_life
    IF hc_moves AND ClkRead(hc_clock)-hc_heard_s>hc_life_s THEN
      StopMove\Quick;
      hc_moves:=FALSE;
      hc_state{5}:=8;
      RAISE HC_STOPPED;
    ENDIF
  ENDTRAP
ENDMODULE
