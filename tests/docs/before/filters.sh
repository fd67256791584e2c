# A line of the report's table.
sed -n '/^scenario,/p; /^fixed,moving average 5/p' sim/msp_lab/filter_study/table.py > mine.csv
