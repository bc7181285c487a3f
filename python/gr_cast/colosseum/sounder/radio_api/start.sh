#!/bin/sh
echo '{"STATUS": "ACTIVE", "INFO": "begins"}' > /root/cast/state
PYTHONPATH=/opt/cast PYTHONDONTWRITEBYTECODE=1 OPENBLAS_NUM_THREADS=1 MPLCONFIGDIR=/tmp nohup python3 -m gr_cast.colosseum.sounder >> /logs/sounder.log 2>&1 &
echo $! > /root/cast/pid
