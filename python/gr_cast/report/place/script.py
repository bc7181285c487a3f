# SPDX-License-Identifier: GPL-3.0-or-later
"""What the page of a place does in a browser: zoom and move, curves of a link that is clicked on, a cause that is pointed at."""

SCRIPT = """
const all=(words,root)=>[...(root||document).querySelectorAll(words)];
function views(name){return all('.view[data-view="'+name+'"]')}
function show(view,box){views(view.dataset.view).forEach(one=>one.setAttribute('viewBox',box.map(v=>v.toFixed(2)).join(' ')))}
all('.view').forEach(view=>{const whole=view.getAttribute('viewBox').split(' ').map(Number);let held=null;
const now=()=>view.getAttribute('viewBox').split(' ').map(Number);
view.addEventListener('wheel',event=>{event.preventDefault();const b=now(),r=view.getBoundingClientRect(),
s=Math.min(1,b[2]/whole[2]*Math.exp(event.deltaY*.0015))*whole[2]/b[2],x=(event.clientX-r.left)/r.width,y=(event.clientY-r.top)/r.height;
show(view,[b[0]+b[2]*x*(1-s),b[1]+b[3]*y*(1-s),b[2]*s,b[3]*s])},{passive:false});
view.addEventListener('pointerdown',event=>{held=[event.clientX,event.clientY,...now()]});
window.addEventListener('pointermove',event=>{if(!held)return;const r=view.getBoundingClientRect(),k=held[4]/r.width;
show(view,[held[2]-(event.clientX-held[0])*k,held[3]-(event.clientY-held[1])*k,held[4],held[5]])});
window.addEventListener('pointerup',()=>held=null);view.addEventListener('dblclick',()=>show(view,whole))});
function chart(c){const W=720,H=230,L=52,B=34,ys=c.series.flatMap(s=>s[2]).filter(v=>v!==null),low=Math.min(...ys),
high=Math.max(...ys,low+1),x0=c.x[0],x1=c.x[c.x.length-1],px=v=>L+(v-x0)/Math.max(x1-x0,1e-9)*(W-L-10),
py=v=>H-B-(v-low)/(high-low)*(H-B-26);let out='';
c.series.forEach((s,k)=>{const points=s[2].map((v,i)=>v===null?null:[px(c.x[i]),py(v)]);
if(s[1]==='dots')out+=points.filter(p=>p).map(p=>'<circle r="2" cx="'+p[0].toFixed(1)+'" cy="'+p[1].toFixed(1)+'"/>').join('');
else out+='<polyline class="'+s[1]+'" points="'+points.filter(p=>p).map(p=>p.map(v=>v.toFixed(1)).join()).join(' ')+'"/>';
out+='<text class="'+s[1]+'" x="'+(L+8+k*130)+'" y="14">'+s[0]+'</text>'});
for(let i=0;i<=4;i++){const v=low+(high-low)*i/4,u=x0+(x1-x0)*i/4;
out+='<text x="'+(L-6)+'" y="'+(py(v)+4)+'" text-anchor="end">'+v.toFixed(high-low>8?0:1)+'</text><text x="'+px(u)+
'" y="'+(H-B+15)+'" text-anchor="middle">'+u.toFixed(x1-x0>8?0:1)+'</text>'}
out+='<path class="axis" fill="none" d="M'+L+' 20V'+(H-B)+'H'+(W-10)+'"/><text x="'+(W-10)+'" y="'+(H-4)+'" text-anchor="end">'+
c.axes[0]+'</text><text x="'+(W-10)+'" y="14" text-anchor="end">'+c.axes[1]+', '+c.title.replace(/</g,'&lt;')+'</text>';
return'<svg viewBox="0 0 '+W+' '+H+'">'+out+'</svg>'}
function link(name){all('.link').forEach(one=>one.classList.toggle('shown',one.dataset.link===name));
const place=document.querySelector('#chart'),title=document.createElement('h2');title.textContent=name.replace('>',' \\u2192 ');
place.innerHTML=(P[name]||[]).map(chart).join('');place.prepend(title)}
all('[data-link]').forEach(one=>one.addEventListener('click',()=>link(one.dataset.link)));
all('.cause').forEach(one=>['mouseenter','mouseleave'].forEach(kind=>one.addEventListener(kind,()=>
all('.mark[data-mark="'+one.dataset.mark+'"]').forEach(mark=>mark.classList.toggle('flash',kind==='mouseenter')))));
"""
