"""The article's experiments: its tables and figures as data, computed by this package and compared with the article.

Bernat and Kolota (2023), "The buffered optimization methods for online transfer function identification employed on
DEAP actuator", Archives of Control Sciences 33(3), 565-587, doi 10.24425/acs.2023.146960.

The article does not print all settings of its tables.  `replant.paper.tables` has settings that reproduce its figures,
and names those that differ from the printed ones.  `replant.paper.actuator` is the experiment of section 4 on a
simulated rig, with a table that the article does not have.
"""
