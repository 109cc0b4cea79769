"""The article's experiments: its tables and figures as data, run by this package and put beside the published ones.

Bernat and Kolota (2023), "The buffered optimization methods for online transfer function identification employed on
DEAP actuator", Archives of Control Sciences 33(3), 565-587, doi 10.24425/acs.2023.146960.

The article leaves out some of the settings that its tables need; `replant.paper.tables.published` holds those with
which its figures come out, and says where they are not the printed ones.  `replant.paper.actuator.experiment` is the
experiment of section 4 on a simulated rig, with the table that the article lacks.

>>> NAMES
('table1', 'table2', 'table3', 'table4', 'fig1', 'fig2', 'fig3', 'fig4', 'fig6', 'fig7', 'fig8', 'actuator')
"""

from replant.paper.actuator.experiment import Actuator, reproduce_actuator
from replant.paper.catalogue import NAMES
from replant.paper.tables.experiment import Experiment, Plant, run
from replant.paper.tables.figures import FIGURES
from replant.paper.tables.published import (
    TABLES,
    Improvement,
    Row,
    Table,
)
from replant.paper.tables.reproduction import (
    SEEDS,
    Cell,
    RowResult,
    TableResult,
    reproduce,
)

__all__ = [
    "FIGURES",
    "NAMES",
    "SEEDS",
    "TABLES",
    "Actuator",
    "Cell",
    "Experiment",
    "Improvement",
    "Plant",
    "Row",
    "RowResult",
    "Table",
    "TableResult",
    "reproduce",
    "reproduce_actuator",
    "run",
]
