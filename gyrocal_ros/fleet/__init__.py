"""Many bags of many robots: calibrations, part-to-part spread, ageing, and effects that all robots lack.

plan       list of bags                 work       one bag becomes a result
result     result of one bag            store      results on disk, resumable; Parquet tables
engine     bags on a Dask cluster       table      the tables as arrays
hierarchy  random-effects model (REML)  pooling    score statistics of many bags
findings   conclusions on a fleet       prior      initial calibration of the next robot
comparison two fleets                  examine    which bag to look at first
summary    conclusions as JSON

The libraries of this room are the extra `fleet`; the other rooms work without them.
"""
