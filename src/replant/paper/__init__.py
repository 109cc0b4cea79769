"""The article's experiments: its tables as data, run by this package and put beside the published figures.

Bernat and Kolota (2023), "The buffered optimization methods for online transfer function identification employed on
DEAP actuator", Archives of Control Sciences 33(3), 565-587, doi 10.24425/acs.2023.146960.

The article leaves out some of the settings that its tables need; `replant.paper.tables` holds those with which its
figures come out, and says where they are not the printed ones.

>>> sorted(TABLES)
['table1', 'table2', 'table3', 'table4']
"""

from replant.paper.experiment import Experiment, Plant, run
from replant.paper.reproduction import SEEDS, Cell, RowResult, TableResult, reproduce
from replant.paper.tables import TABLES, Improvement, Row, Table

__all__ = [
    "SEEDS",
    "TABLES",
    "Cell",
    "Experiment",
    "Improvement",
    "Plant",
    "Row",
    "RowResult",
    "Table",
    "TableResult",
    "reproduce",
    "run",
]
