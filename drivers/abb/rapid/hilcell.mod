MODULE hilcell
  ! hilcell: motions, their watchdog, and the position stream, in task T_ROB1.
  ! The PC writes hc_target and hc_seconds, then a number into hc_order: it starts the motion, and
  ! hc_state shows it when the motion has ended. The PC counts hc_life up meanwhile; where it does
  ! not for 1.5 s, the motion is stopped. The robot moves by MoveAbsJ to fine points alone. Another
  ! hc_session ends the program.
  CONST num hc_version:=3;
  ! The UDP unicast device of the position stream.
  CONST string hc_device:="UCdevice";
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
  ! The reflector's centre on the flange, without rotation, and the load. A load below the true one
  ! overloads the arm: ENTER its mass in kg and its centre of gravity; else nothing moves.
  ! TO BE FILLED IN: three times 0 is no cell's; enter robot.smr_mm of the cell file.
  PERS tooldata hc_tool:=[TRUE,[[0,0,0],[1,0,0,0]],[0.001,[0,0,0.001],[1,0,0,0],0,0,0]];
  CONST num hc_no_load_kg:=0.001;
  CONST num hc_cycle_s:=0.02;
  CONST num hc_arrived_deg:=0.01;
  LOCAL VAR egmident hc_egm;
  LOCAL VAR clock hc_clock;
  LOCAL VAR num hc_heard_s:=0;

  PROC hc_main()
    IF hc_tool.tload.mass<=hc_no_load_kg THEN
      TPWrite "enter the load of hc_tool in module hilcell";
      EXIT;
    ENDIF
    hc_order:=0;
    hc_brake:=0;
    hc_state:=[hc_version,0,hc_life,0,0,0];
    ClkReset hc_clock;
    ClkStart hc_clock;
    EGMReset hc_egm;
    EGMGetId hc_egm;
    EGMSetupUC ROB_1,hc_egm,"default",hc_device\Joint;
    EGMStreamStart hc_egm\SampleRate:=4;
    ! The session last: from here on the PC gives orders.
    hc_state{2}:=hc_session;
    WHILE hc_session=hc_state{2} DO
      hc_hear;
      IF hc_order<>hc_state{4} hc_move;
      WaitTime hc_cycle_s;
    ENDWHILE
    ! A controller has four identities of EGM; one that is not given back is lost until a restart.
    EGMStreamStop hc_egm;
    EGMReset hc_egm;
    ! Never on into the main routine of another program, in whatever run mode.
    Stop;
  ENDPROC

  ! The motion runs beside the program (\Conc), which watches it. Where it is stopped, what is left
  ! of the path is dropped, and the robot stays.
  PROC hc_move()
    VAR num number;
    VAR jointtarget goal;
    number:=hc_order;
    goal:=hc_target;
    hc_state{6}:=number;
    hc_state{5}:=0;
    ! A brake may come before its order.
    IF hc_brake=number THEN
      hc_state{5}:=9;
      hc_state{4}:=number;
      RETURN;
    ENDIF
    hc_heard_s:=ClkRead(hc_clock);
    MoveAbsJ\Conc,goal\NoEOffs,v1000\T:=hc_seconds,fine,hc_tool;
    WHILE hc_state{5}=0 AND NOT hc_at(goal) DO
      WaitTime hc_cycle_s;
      hc_hear;
      IF hc_brake=number THEN
        hc_halt 9;
      ELSEIF ClkRead(hc_clock)-hc_heard_s>hc_life_s THEN
        hc_halt 8;
      ENDIF
    ENDWHILE
    WaitRob\ZeroSpeed;
    hc_state{4}:=number;
  ENDPROC

  LOCAL PROC hc_hear()
    IF hc_life<>hc_state{3} THEN
      hc_heard_s:=ClkRead(hc_clock);
      hc_state{3}:=hc_life;
    ENDIF
  ENDPROC

  ! Without \Quick: RobotWare 7.21 does not know it.
  LOCAL PROC hc_halt(num why)
    StopMove;
    ClearPath;
    StartMove;
    hc_state{5}:=why;
  ENDPROC

  LOCAL FUNC bool hc_at(jointtarget goal)
    VAR jointtarget now;
    now:=CJointT();
    RETURN Abs(now.robax.rax_1-goal.robax.rax_1)<hc_arrived_deg
      AND Abs(now.robax.rax_2-goal.robax.rax_2)<hc_arrived_deg
      AND Abs(now.robax.rax_3-goal.robax.rax_3)<hc_arrived_deg
      AND Abs(now.robax.rax_4-goal.robax.rax_4)<hc_arrived_deg
      AND Abs(now.robax.rax_5-goal.robax.rax_5)<hc_arrived_deg
      AND Abs(now.robax.rax_6-goal.robax.rax_6)<hc_arrived_deg;
  ENDFUNC
ENDMODULE
