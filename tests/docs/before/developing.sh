# A campaign of flights without a truth that is complete: it takes a minute a case.
mkdir -p build/others-1
case='"seed": 1, "sensor": "front_left", "standard_errors": 10.0, "sensor_right": true, "effect_right": true, "seconds": 1.0'
echo "{\"again\": \"1:0:10\", $case, \"effect\": \"latency\", \"parameters\": {}, \"named\": {}}" > build/others-1/cases.jsonl
echo "{\"again\": \"1:0:null\", $case, \"effect\": null, \"parameters\": {}, \"named\": {}}" >> build/others-1/cases.jsonl
