"""The logs: where each lies, which columns, which clock, and the structure that is fitted to it.

All come from rigs, as far as their sources tell; none ships with replant.  Where the source gives no sampling time it
is 1.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Log:
    """A public log.

    Attributes
    ----------
    name : str
    repository, commit, path : str
        On GitHub; ``output_path`` names a second file where the output lies in one of its own.
    licence : str
        Of the repository, as it states it.
    what : str
        What was measured: the rig; input and output with their units.
    input, output, reference : str
        Number of a text column, or variable, field and column of a .mat file; "" for no reference.
    dt : float
        Sampling time in s, of the rows used.
    poles, zeros, delay : int, int, float
        The structure to fit.
    loop : {"open", "closed"}
    rows : (int or None, int or None, int)
        First row, the row behind the last, and step.
    """

    name: str
    repository: str
    commit: str
    path: str
    licence: str
    what: str
    input: str
    output: str
    dt: float
    poles: int
    zeros: int = 0
    delay: float = 0.0
    loop: str = "open"
    reference: str = ""
    output_path: str = ""
    rows: tuple[int | None, int | None, int] = (None, None, 1)


RGP = ("zhenwendai/RGP", "be679607d3457a1038a2fe39b36b816ea380ea39")
FARNN = ("robotsorcerer/FARNN", "9cfb82f2b42a53a604dba66d0eab23243a9a21ae")
SHIELD = ("gergelytakacs/AutomationShield", "bc0778f97a156d4ea5158725e09068d438e59a39")
LPV = ("gsmfnc/LPV_SysId", "a843d61efb1401308c932bd77b6653446bbdd351")
PYTHON = ("wilsonrljr/sysidentpy", "433a514de1e57e46b34431d16a181b0cbb35952a")
RAFA = ("Rafa7046/Non_Linear_Identification", "e5c9b006b0a2ec1650bc018a5fb38d2f4363d4c7")
ROBOT = ("vhsabino/MATLAB", "bc6d16ac215616f7cfc256c862144165f9b11d2b")
RULER = ("ryanGT/systemid", "fbfab3750040d9625ae057916f4c7292ad8e7d24")
SHADES = ("JulienLeprince/fiftyshadesofgrey", "0e670018c93aeccc973ca38701c96d204818b352")
STRAW = ("tylim2946/BCIT", "e99ea1cb8c4403093584f3acf34258a97a89f04c")
SHAFT = ("malik-robert/HSM150-data", "35c3b1be8a4c2215ff981eb00bb3ed439e9f524b")
KANTOR = ("jckantor/CBE30338", "93418114a42775804cd419126e6e1d09f609ee3d")
BOILER = ("felypemaciel/temp_control", "c66b4b5a7a2c03adb37a0e8e0228eb70bc511962")
BSD, MIT, APACHE, NC, NONE = "BSD-3-Clause", "MIT", "Apache-2.0", "CC BY-NC-ND 4.0", "none stated"
SETS, EXAMPLES, CODERS = "datasets/system_identification", "matlab/examples", "noise_simulations/autoencoders"

LOGS = (
    # process and thermal
    Log("hair dryer", *RGP, f"{SETS}/dryer.dat", BSD, "laboratory dryer (DaISy 96-006): heater [V], thermocouple [V]",
        "0", "1", 0.08, 2, 0, 0.16),
    Log("gas furnace", *RGP, f"{SETS}/gas_furnace.csv", BSD, "series J of Box and Jenkins: gas [cu ft/min], CO2 [%]",
        "0", "1", 9.0, 1, 0, 27.0),
    Log("industrial dryer", *FARNN, "data/dryer2.dat", MIT, "DaISy 96-016: fuel flow, dry-bulb temperature",
        "1", "4", 10.0, 1),
    Log("evaporator", *FARNN, "data/evaporator.dat", MIT, "four stages (DaISy 96-010): cooling water, temperature",
        "2", "5", 1.0, 1),
    Log("wall", *FARNN, "data/thermic_res_wall.dat", MIT, "DaISy 96-011: inner temperature [degC], heat flow",
        "0", "2", 600.0, 2, 1),
    Log("halogen heater", *FARNN, "data/heating_system.dat", MIT, "DaISy 99-001: lamp [V], temperature [degC]",
        "1", "2", 2.0, 2, 1),
    Log("glass furnace", *FARNN, "data/glassfurnace.dat", MIT, "DaISy 96-002: cooling, temperature",
        "2", "4", 1.0, 1),
    Log("power plant", *FARNN, "data/powerplant.dat", MIT, "120 MW (DaISy 96-003): gas flow, steam pressure",
        "1", "6", 1228.8, 2),
    Log("HeatShield", *SHIELD, f"{EXAMPLES}/HeatShield/resultID2.mat", NC, "printer head: power [%], [degC]",
        "resultID,1", "resultID,0", 2.0, 2, 1),
    Log("TCLab step", *KANTOR, "notebooks/data/0B.99-Step_Test_Data.csv", MIT, "transistor: heater [%], [degC]",
        "6", "4", 1.0, 2),
    Log("boiler", *BOILER, "serial_output.csv", NONE, "heater [V], temperature [degC]",
        "2", "0", 0.5, 2, rows=(None, None, 10)),
    Log("straw-bale house", *STRAW, "ELEX4336-Feedback-Systems/Lab05/temps.mat", APACHE,
        "outdoor and indoor temperature [degC]", "ExtTemp", "IntTemp", 192.0, 1),
    Log("Dutch house", *SHADES, "data/in/blg_1.csv", MIT, "heating [kW], indoor temperature [degC], thermostat",
        "6", "5", 900.0, 2, 1, loop="closed"),
    # fluids
    Log("cascaded tanks", *RGP, f"{SETS}/tank.mat", BSD, "Uppsala: pump [V], lower level [V]", "u", "y,0", 5.0, 2),
    Log("overflowing tanks", *RAFA, "src/data/tanque.csv", NONE, "benchmark of 2016: pump [V], lower level [V]",
        "0", "2", 4.0, 2),
    Log("two tanks", *LPV, f"{CODERS}/TwoTanksMatlab.mat", BSD, "pump [V], lower level [m]", "U", "Y", 0.2, 2),
    Log("FloatShield", *SHIELD, f"{EXAMPLES}/FloatShield/PRBS_R4.txt", NC, "ball in an air tube: fan [%], height [mm]",
        "1", "0", 0.025, 2),
    Log("PressureShield", *SHIELD, f"{EXAMPLES}/PressureShield/BlackBoxModel.mat", NC, "pump and vessel",
        "resultID,0", "resultID,1", 0.01, 2),
    Log("hydraulic crane", *RGP, f"{SETS}/actuator.mat", BSD, "valve opening, oil pressure", "u", "p", 1.0, 2, 1),
    # drives and robots
    Log("MotoShield", *SHIELD, f"{EXAMPLES}/MotoShield/aprbsResult.mat", NC, "DC motor: [V], speed", "u", "y", 0.02, 1),
    Log("MotoShield PID", *SHIELD, "response.mat", NC, "the same motor under its controller: [%], speed",
        "response,2", "response,1", 0.04, 1, loop="closed", reference="response,0"),
    Log("HSM150", *SHAFT, "Data/Identification/idf_pos_0.06_1.mat", NONE, "two motors on a shaft: torque [Nm], [rad/s]",
        "data,4", "data,3", 0.001, 1),
    Log("two motors", *PYTHON, "examples/datasets/x_cc.csv", BSD, "motor and generator: [V], speed",
        "0", "0", 25.0, 2, output_path="examples/datasets/y_cc.csv", rows=(None, None, 25)),
    Log("robot wheel", *ROBOT, "INPUT_1_28_07_19.csv", NONE, "brushless motor: [%], speed",
        "0", "0", 0.005, 1, output_path="M1_1_28_07_19.csv"),
    Log("winding", *FARNN, "data/winding.dat", MIT, "three reels (DaISy 97-003): motor current, web tension",
        "3", "5", 0.1, 1),
    Log("ruler robot", *RULER, "example/2009-04-21/swept1-0-10hz.txt", NONE, "flexible link: motor, encoder [counts]",
        "2", "4", 0.002, 2),
    Log("industrial robot", *LPV, f"{CODERS}/RobotArm.mat", BSD, "ABB arm: torque, speed, under its controller",
        "U", "Y", 0.0005, 3, 2, loop="closed"),
    # vibration and balance
    Log("robot arm", *FARNN, "data/robot_arm.dat", MIT, "flexible (DaISy 96-009): torque, acceleration",
        "0", "1", 1.0, 2, 1),
    Log("wing flutter", *RGP, f"{SETS}/flutter.dat", BSD, "DaISy 96-008", "0", "1", 1.0, 4, 3),
    Log("LinkShield", *SHIELD, f"{EXAMPLES}/LinkShield/resultID.mat", NC, "flexible link: servo [deg], bending",
        "u", "y", 0.003, 3, 2),
    Log("AeroShield", *SHIELD, f"{EXAMPLES}/AeroShield/ident_data.txt", NC, "pendulum with a propeller: [V], [rad]",
        "1", "0", 0.01, 2),
    Log("AeroShield LQ", *SHIELD, f"{EXAMPLES}/AeroShield/LQ_mega.txt", NC, "the same pendulum under its controller",
        "2", "1", 0.01, 2, loop="closed", reference="0", rows=(None, -1, 1)),
    Log("BicopShield", *SHIELD, f"{EXAMPLES}/BicopShield/BicopShield_PID/pid1.csv", NC, "two propellers: [%], [deg]",
        "4", "0", 0.01, 2, loop="closed", reference="1"),
    Log("BoBShield", *SHIELD, f"{EXAMPLES}/BoBShield/dataPidAll.mat", NC, "ball on a beam: [deg], [mm]",
        "dataAll,2", "dataAll,1", 0.01, 2, loop="closed", reference="dataAll,0"),
    Log("ball and beam", *RGP, f"{SETS}/ballbeam.dat", BSD, "DaISy 96-004: angle, position",
        "0", "1", 0.1, 2, loop="closed"),
    Log("damper", *LPV, f"{CODERS}/Magneto.mat", BSD, "magneto-rheological: velocity [cm/s], force [N]",
        "U", "Y", 0.005, 1),
    # electronics and light
    Log("silverbox", *RAFA, "src/data/SNLS80mV.csv", NONE, "oscillating circuit, Brussels: [V], [V]",
        "0", "1", 2**14 / 1e7, 2, 1, rows=(0, 20000, 1)),
    Log("Wiener-Hammerstein", *LPV, f"{CODERS}/datasets/wh.mat", BSD, "circuit with a diode, Brussels: [V], [V]",
        "U", "Y", 1 / 51200, 3, 2, rows=(0, 20000, 1)),
    Log("buck converter", *PYTHON, "examples/datasets/buck_id.csv", BSD, "duty [V], output [V]", "1", "2", 1e-5, 2),
    Log("OptoShield", *SHIELD, f"{EXAMPLES}/OptoShield/resultID.mat", NC, "lamp [%], photoresistor [%]",
        "resultID,1", "resultID,0", 0.005, 1),
    Log("OptoShield PID", *SHIELD, f"{EXAMPLES}/OptoShield/result.mat", NC, "the same lamp under its controller",
        "result,2", "result,1", 0.01, 1, loop="closed", reference="result,0"),
    Log("cd player", *FARNN, "data/CD_player_arm.dat", MIT, "DaISy 96-007: actuator force, tracking",
        "1", "3", 1.0, 3, 2, loop="closed"),
)  # fmt: skip
